"""Reads NumPy files, if they contain only numbers and fit a limit of memory."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.files.limited_memory import limited_memory
from pipeline.files.plain_file import NotReadable, read_bytes, size
from tactile.readers.decimal_number import LARGEST
from tactile.readers.recording_fields import Shape, fits, shape_said

MOST_BYTES = 400_000_000
"""Largest file: twenty minutes of 400 markers at 30 frames a second."""
MOST_MEMORY = 1_000_000_000
"""Most memory for the unpacked arrays, in double precision: a few kilobytes can expand to terabytes."""


def array_fault(values: np.ndarray, shape: Shape, *, like: str = "") -> tuple[str, str] | None:
    """What was found and expected if the shape is wrong, or numbers are not finite or too large; None if all
    is right. `like`: the reason for the expected shape, as the end of a sentence.
    """
    if not fits(values.shape, shape):
        return f"shape {values.shape}", shape_said(shape) + like
    if not np.isfinite(values).all():
        where = f" in frame {int(np.argwhere(~np.isfinite(values))[0][0])}" if values.ndim else ""
        return f"a value{where} that is not finite", "finite numbers"
    if np.abs(values).max(initial=0.0) > LARGEST:
        return f"{np.abs(values).max():g}", f"numbers up to {LARGEST:g}"
    return None


def load_npy(path: Path) -> np.ndarray:
    """The array in an .npy file, in double precision. Raises NotReadable."""
    return next(iter(load_npz(path).values()))


def load_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name ("" for an .npy file), in double precision. Raises NotReadable."""
    data = io.BytesIO(read_bytes(path, most_bytes=MOST_BYTES))
    try:
        with limited_memory(MOST_MEMORY):
            held: Any = np.load(data, allow_pickle=False)
            arrays = {"": held} if isinstance(held, np.ndarray) else dict(held.items())
            return {name: _numbers(array) for name, array in arrays.items()}
    except MemoryError as error:
        raise NotReadable(f"unpacks to more than {size(MOST_MEMORY)}") from error
    except NotReadable:
        raise
    except Exception as error:  # a broken header or archive raises many kinds of errors
        raise NotReadable("is no whole NumPy file") from error


def _numbers(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "fiub":
        raise NotReadable(f"holds values of type {array.dtype}, no numbers")
    return np.asarray(array, dtype=np.float64)

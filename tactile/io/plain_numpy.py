"""NumPy's own files, read only as far as they are numbers and of bounded size."""

import io
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from pipeline.files.plain_file import NotReadable, read_bytes, size
from tactile.io.decimal_number import LARGEST
from tactile.io.recording_fields import Shape, fits, shape_said

MOST_BYTES = 400_000_000
"""Of a file, and of what it unpacks to: twenty minutes of 400 markers at 30 frames a second."""
MOST_ARRAYS = 200
"""In an archive: recordings have a dozen for each pad. Set by hand."""
MOST_VALUES = MOST_BYTES // 8
"""In double precision, as they are handed on: bytes become eight times as many."""


def array_fault(values: np.ndarray, shape: Shape, *, like: str = "") -> tuple[str, str] | None:
    """What was found and expected where a shape does not fit, or numbers are not finite or too large; None
    where nothing is wrong. `like`: why the shape is expected, as the end of a sentence.
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
    """The array in an .npy file; numbers are converted to double precision. Raises NotReadable."""
    return _array(io.BytesIO(read_bytes(path, most_bytes=MOST_BYTES)))


def load_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name, in double precision; raises NotReadable.

    What an archive unpacks to is counted before it is unpacked: a few kilobytes of it can promise terabytes.
    """
    data = read_bytes(path, most_bytes=MOST_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            held = archive.infolist()
            if len(held) > MOST_ARRAYS or sum(member.file_size for member in held) > MOST_BYTES:
                raise NotReadable(f"unpacks to more than {size(MOST_BYTES)} or {MOST_ARRAYS} arrays")
            arrays: dict[str, np.ndarray] = {}
            for member in held:
                left = MOST_VALUES - sum(array.size for array in arrays.values())
                arrays[member.filename.removesuffix(".npy")] = _array(
                    _opened(archive, member), most_values=left
                )
            return arrays
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError) as error:
        raise NotReadable("is no whole .npz file") from error


def _opened(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> io.BytesIO:
    with archive.open(member) as file:
        data = file.read(member.file_size + 1)
    return io.BytesIO(data)


def _array(file: Any, *, most_values: int = MOST_VALUES) -> np.ndarray:
    """One array; its header is held against the bytes that follow before memory is asked for it."""
    try:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read(file)
    except Exception as error:  # its header is a Python literal: a broken one fails in a dozen ways
        raise NotReadable("is no whole NumPy file") from error
    if dtype.kind not in "fiub":
        raise NotReadable(f"holds values of type {dtype}, no numbers")
    start = file.tell()
    length = file.seek(0, io.SEEK_END) - start
    if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize > length:
        raise NotReadable("was cut short (its header promises more)")
    if math.prod(shape) > most_values:
        raise NotReadable(f"holds more than {MOST_VALUES} values")
    file.seek(0)
    try:
        return np.asarray(npy.read_array(file, allow_pickle=False), dtype=np.float64)
    except (ValueError, EOFError, OSError) as error:
        raise NotReadable("is no whole NumPy file") from error

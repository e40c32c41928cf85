"""Reads Tac3D recordings from the maker's recorder: one folder of NumPy arrays per sensor serial number.

`index.npy` (T,), `sendTimestamp.npy` (T,) s, `3D_Positions.npy`, `3D_Displacements.npy` (mm) and
`3D_Forces.npy` (N) of (T, N, 3); some also `recvTimestamp.npy` (s). Axes are the sensor's: z points out of
the gel. Forces act on the gel (pressed: negative z).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from pipeline.files.plain_file import NotReadable
from tactile.readers.pictures import absence
from tactile.readers.plain_numpy import array_fault, load_npy
from tactile.readers.recording_fields import Shape
from tactile.tactile_failure import TactileFailure, TactileProblem

FIELDS = ("3D_Positions", "3D_Displacements", "3D_Forces")


@dataclass(frozen=True, kw_only=True)
class Tac3D:
    """One sensor's recording, in its own axes and signs; `receive_s` is None if the file is missing."""

    serial: str
    index: Int[np.ndarray, " t"]
    send_s: Float[np.ndarray, " t"]
    receive_s: Float[np.ndarray, " t"] | None
    position_mm: Float[np.ndarray, "t n 3"]
    displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]


def sensor_folders(folder: Path) -> tuple[Path, ...]:
    """The folders of single sensors: this one, or its subfolders, by name."""
    if not folder.is_dir():
        return ()
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    return (folder,) if _is_sensors(folder) else tuple(path for path in inside if _is_sensors(path))


def _is_sensors(folder: Path) -> bool:
    return any(_has(folder, name) for name in FIELDS[1:])


def _has(folder: Path, name: str) -> bool:
    return (folder / f"{name}.npy").is_file()


def read_tac3d(folder: Path) -> Tac3D:
    """One sensor's recording; raises TactileFailure (unreadable-recording) that names file and fault."""
    index = _array(folder, "index", (None,)).astype(np.int64)
    frames = len(index)
    if frames < 2:
        raise _refused(folder, "index", f"{frames} frames", "two or more")
    displacement = _array(folder, FIELDS[1], (frames, None, 3))
    shape = displacement.shape
    return Tac3D(
        serial=folder.name,
        index=index,
        send_s=_array(folder, "sendTimestamp", (frames,)),
        receive_s=_array(folder, "recvTimestamp", (frames,)) if _has(folder, "recvTimestamp") else None,
        position_mm=_array(folder, FIELDS[0], shape),
        displacement_mm=displacement,
        force_N=_array(folder, FIELDS[2], shape),
    )


def _array(folder: Path, name: str, shape: Shape) -> np.ndarray:
    path = folder / f"{name}.npy"
    if missing := absence(path):
        raise _refused(folder, name, missing, "the recorder's array; copy the whole folder")
    try:
        values = load_npy(path)
    except NotReadable as cause:
        raise _refused(folder, name, f"that it {cause}", "a whole NumPy array; copy it again") from cause
    if fault := array_fault(values, shape, like=" as the other arrays have"):
        raise _refused(folder, name, *fault)
    return values


def _refused(folder: Path, name: str, fault: str, expected: str) -> TactileFailure:
    detail = f"{folder.name}/{name}.npy: found {fault}, expected {expected}."
    return TactileProblem.UNREADABLE_RECORDING.failure(detail)

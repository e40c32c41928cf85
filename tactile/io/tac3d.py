"""Tac3D recordings as the maker's recorder saves them: one folder of NumPy arrays per sensor serial number.

`index.npy` (T,), `sendTimestamp.npy` (T,) s, `3D_Positions.npy`, `3D_Displacements.npy` (mm) and
`3D_Forces.npy` (N) of (T, N, 3), `3D_ResultantForce.npy` (N) and `3D_ResultantMoment.npy` (N·mm) of (T, 1, 3)
or (T, 3); some also `3D_Normals.npy` and `recvTimestamp.npy` (s). Axes are the sensor's own: z out of the
gel; forces are those that the gel feels (pressed: negative z).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float, Int

from pipeline.files.plain_file import NotReadable
from tactile.io.pictures import absence
from tactile.io.plain_numpy import array_fault, load_npy
from tactile.io.recording_fields import Shape
from tactile.tactile_failure import TactileFailure, TactileProblem

FIELDS = ("3D_Positions", "3D_Displacements", "3D_Forces")
RESULTANTS = ("3D_ResultantForce", "3D_ResultantMoment")


@dataclass(frozen=True, kw_only=True)
class Tac3D:
    """What one sensor's folder holds, in its own axes and signs; `None` where a file is not there."""

    serial: str
    index: Int[np.ndarray, " t"]
    send_s: Float[np.ndarray, " t"]
    receive_s: Float[np.ndarray, " t"] | None
    position_mm: Float[np.ndarray, "t n 3"]
    displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    normal: Float[np.ndarray, "t n 3"] | None
    resultant_force_N: Float[np.ndarray, "t 3"]
    resultant_moment_Nmm: Float[np.ndarray, "t 3"]

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything, under the maker's names."""
        held: dict[str, np.ndarray | None] = {
            "index": self.index,
            "sendTimestamp": self.send_s,
            "recvTimestamp": self.receive_s,
            "3D_Positions": self.position_mm,
            "3D_Displacements": self.displacement_mm,
            "3D_Forces": self.force_N,
            "3D_Normals": self.normal,
            "3D_ResultantForce": self.resultant_force_N,
            "3D_ResultantMoment": self.resultant_moment_Nmm,
        }
        return {name: values for name, values in held.items() if values is not None}


def sensor_folders(folder: Path) -> tuple[Path, ...]:
    """The folders of single sensors: this one, or those in it, by name."""
    if not folder.is_dir():
        return ()
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    return (folder,) if _is_sensors(folder) else tuple(path for path in inside if _is_sensors(path))


def _is_sensors(folder: Path) -> bool:
    return any((folder / f"{name}.npy").is_file() for name in ("3D_Displacements", "3D_Forces"))


def read_tac3d(folder: Path) -> Tac3D:
    """One sensor's recording; raises TactileFailure (unreadable-recording) that names file and fault."""
    index = _array(folder, "index", (None,)).astype(np.int64)
    frames = len(index)
    if frames < 2:
        raise _refused(folder, "index", f"{frames} frames", "two or more")
    displacement = _array(folder, "3D_Displacements", (frames, None, 3))
    shape = displacement.shape
    return Tac3D(
        serial=folder.name,
        index=index,
        send_s=_array(folder, "sendTimestamp", (frames,)),
        receive_s=_optional(folder, "recvTimestamp", (frames,)),
        position_mm=_array(folder, "3D_Positions", shape),
        displacement_mm=displacement,
        force_N=_array(folder, "3D_Forces", shape),
        normal=_optional(folder, "3D_Normals", shape),
        resultant_force_N=_vectors(folder, "3D_ResultantForce", frames),
        resultant_moment_Nmm=_vectors(folder, "3D_ResultantMoment", frames),
    )


def _vectors(folder: Path, name: str, frames: int) -> Float[np.ndarray, "t 3"]:
    values = _loaded(folder, name)
    if values.shape == (frames, 1, 3):
        values = values[:, 0]
    return _checked(folder, name, values, (frames, 3))


def _optional(folder: Path, name: str, shape: Shape) -> np.ndarray | None:
    return _array(folder, name, shape) if (folder / f"{name}.npy").is_file() else None


def _array(folder: Path, name: str, shape: Shape) -> np.ndarray:
    return _checked(folder, name, _loaded(folder, name), shape)


def _loaded(folder: Path, name: str) -> np.ndarray:
    path = folder / f"{name}.npy"
    if missing := absence(path):
        raise _refused(folder, name, missing, "the recorder's array; copy the whole folder")
    try:
        return load_npy(path)
    except NotReadable as cause:
        raise _refused(folder, name, f"that it {cause}", "a whole NumPy array; copy it again") from cause


def _checked(folder: Path, name: str, values: np.ndarray, shape: Shape) -> np.ndarray:
    if fault := array_fault(values, shape, like=" as the other arrays have"):
        raise _refused(folder, name, *fault)
    return values


def _refused(folder: Path, name: str, fault: str, expected: str) -> TactileFailure:
    detail = f"{folder.name}/{name}.npy: found {fault}, expected {expected}."
    return TactileFailure(TactileProblem.UNREADABLE_RECORDING, detail)


def write_source(path: Path, sensors: Sequence[Tac3D]) -> None:
    """Adds `source/<serial>/<array>` to a recording: full precision, the sensor's own axes and signs."""
    with h5py.File(path, "a") as file:
        for sensor in sensors:
            group = file.create_group(f"source/{sensor.serial}")
            for name, values in sensor.arrays().items():
                group.create_dataset(name, data=values, compression="gzip", shuffle=True)

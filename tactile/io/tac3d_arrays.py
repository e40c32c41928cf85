"""The maker's own arrays, kept in the canonical file beside what was made of them."""

from collections.abc import Sequence
from pathlib import Path

import h5py

from tactile.io.tac3d import Tac3D


def write_source(path: Path, sensors: Sequence[Tac3D]) -> None:
    """Adds `source/<serial>/<array>` to a recording: full precision, the sensor's own axes and signs."""
    with h5py.File(path, "a") as file:
        for sensor in sensors:
            group = file.create_group(f"source/{sensor.serial}")
            for name, values in sensor.arrays().items():
                group.create_dataset(name, data=values, compression="gzip", shuffle=True)

"""The maker's own Tac3D recordings, converted.

    python benchmarks/tac3d_recordings.py FOLDER --out DIR

Downloads the wheel `pytac3d` 3.3.0.9 by name into FOLDER (never installed; no licence is stated, so nothing
of it belongs into a repository), unpacks its three recordings there, converts them, says what was noticed,
and checks that no number changed but for sign and origin.
"""

import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from script import run

from tactile.from_tac3d import recording_of_tac3d, rest_of
from tactile.readers.recording import GelPad, Recording, read_recording, write_recording
from tactile.readers.tac3d import Tac3D, read_tac3d, sensor_folders

WHEEL = "pytac3d==3.3.0.9"


def unpacked(folder: Path) -> list[Path]:
    """The recordings' folders, downloaded and unpacked where they are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    if not list(folder.glob("pytac3d-*.whl")):
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--dest", str(folder), WHEEL]
        subprocess.run(command, check=True, capture_output=True)
    wheel = next(folder.glob("pytac3d-*.whl"))
    with zipfile.ZipFile(wheel) as held:
        held.extractall(folder, [name for name in held.namelist() if name.endswith(".npy")])
    return sorted({index_path.parent.parent for index_path in folder.rglob("index.npy")})


def largest_change(sensors: list[Tac3D], again: Recording) -> float:
    """Largest difference, in parts of the largest value, of what the first sensor's canonical file holds."""
    sensor, pad = sensors[0], again.pads[0]
    assert isinstance(pad, GelPad)
    kept = len(again.time_s)
    first = int(np.argmin(np.abs(sensor.send_s - sensor.send_s[0] - again.time_s[0])))
    rows = slice(first, first + kept)
    pairs = [
        (pad.displacement_mm, sensor.displacement_mm[rows]),
        (-pad.force_N, sensor.force_N[rows]),
        (pad.rest_mm - pad.rest_mm[0], rest_of(sensor) - rest_of(sensor)[0]),
        (again.time_s, sensor.send_s[rows] - sensor.send_s[0]),
    ]
    return max(float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-12)) for a, b in pairs)


def main(folder: Path, out: Annotated[Path, typer.Option()]) -> None:
    """Notes and the largest change of every recording."""
    out.mkdir(parents=True, exist_ok=True)
    for place in unpacked(folder):
        groups = [[read_tac3d(folder)] for folder in sensor_folders(place)]
        if len(groups) == 2:
            groups.append([sensor for group in groups for sensor in group])
        for sensors in groups:
            name = "+".join(sensor.serial for sensor in sensors)
            converted = recording_of_tac3d(sensors, fruit_id=name, category="unknown")
            file = out / f"{name}.h5"
            write_recording(file, converted.recording)
            print(f"{name}: {len(converted.recording.time_s)} frames")
            for note in converted.notes:
                print(f"  note: {note}")
            changed = largest_change(sensors, read_recording(file))
            print(f"  largest relative change of a number in the canonical file: {changed:.1e}")


if __name__ == "__main__":
    run(main)

"""The maker's own Tac3D recordings, read and judged.

    python benchmarks/tac3d_recordings.py FOLDER --out DIR

Downloads the wheel `pytac3d` 3.3.0.9 by name into FOLDER (never installed; no licence is stated, so nothing
of it belongs into a repository), unpacks its three recordings there, converts them, says what was noticed,
checks that no number changed but for sign and origin, and draws force, phases, patch area, stick ratio and
noise over time.
"""

import argparse
import subprocess
import sys
import zipfile
from pathlib import Path

import matplotlib as mpl
import numpy as np

from tactile.contact import find_contact
from tactile.contact_course import Course, contact_course
from tactile.from_tac3d import recording_of_tac3d, rest_of
from tactile.io.recording import GelPad, Recording, read_recording, write_recording
from tactile.io.tac3d import Tac3D, read_tac3d, sensor_folders
from tactile.tactile_failure import TactileFailure

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
    return sorted({found.parent.parent for found in folder.rglob("index.npy")})


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


def frame_noise(values: np.ndarray) -> np.ndarray:
    """Per frame, one value's noise from second differences (zero in a deadband)."""
    bends = np.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    return np.asarray(np.median(bends, axis=(1, 2)) / 0.6745 / np.sqrt(6))


def drawn(name: str, recording: Recording, path: Path) -> dict[str, float]:
    """Five curves per pad over time; returns the numbers worth a table."""
    from matplotlib import pyplot as plt

    contact = find_contact(recording, source=name)
    figure, axes = plt.subplots(4, 1, figsize=(7, 7.5), sharex=True)
    numbers: dict[str, float] = {}
    for course, gel in zip(contact_course(contact), recording.pads, strict=True):
        assert isinstance(gel, GelPad)
        noise_um = frame_noise(gel.displacement_mm) * 1e3
        axes[0].plot(recording.time_s, course.normal_N, label=course.pad)
        axes[1].plot(recording.time_s, course.patch_mm2, label=course.pad)
        axes[2].plot(recording.time_s, course.stick_ratio, label=course.pad)
        axes[3].plot(recording.time_s[1:-1], noise_um, label=course.pad)
        numbers |= _numbers(course, noise_um)
    touched = np.any([(pad.episode >= 0).any(axis=1) for pad in contact.pads], axis=0)
    for axis, label in zip(axes, ("normal force, N", "patch, mm²", "stick ratio", "noise, µm"), strict=True):
        axis.fill_between(
            recording.time_s, 0, 1, where=touched, transform=axis.get_xaxis_transform(), color="0.92"
        )
        axis.set_ylabel(label)
        axis.legend(fontsize=7)
    axes[3].set_xlabel("time, s (grey: in contact)")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
    return numbers


def _numbers(course: Course, noise_um: np.ndarray) -> dict[str, float]:
    starts = int((np.diff(course.touches.astype(int)) == 1).sum()) + int(course.touches[0])
    return {
        f"{course.pad} largest force, N": float(course.normal_N.max()),
        f"{course.pad} contacts": float(starts),
        f"{course.pad} largest patch, mm2": float(np.nanmax(course.patch_mm2)),
        f"{course.pad} mean stick ratio in contact": float(course.stick_ratio[course.touches].mean()),
        f"{course.pad} noise in contact, um": float(np.median(noise_um[noise_um > 0])),
    }


def main() -> None:
    """Notes, numbers and pictures of every recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    mpl.use("Agg")
    for place in unpacked(given.folder):
        groups = [[read_tac3d(folder)] for folder in sensor_folders(place)]
        if len(groups) == 2:
            groups.append([one for group in groups for one in group])
        for sensors in groups:
            name = "+".join(sensor.serial for sensor in sensors)
            converted = recording_of_tac3d(sensors, fruit_id=name, category="unknown")
            file = given.out / f"{name}.h5"
            write_recording(file, converted.recording)
            print(f"{name}: {len(converted.recording.time_s)} frames")
            for note in converted.notes:
                print(f"  note: {note}")
            changed = largest_change(sensors, read_recording(file))
            print(f"  largest relative change of a number in the canonical file: {changed:.1e}")
            try:
                numbers = drawn(name, converted.recording, given.out / f"{name}.png")
            except TactileFailure as reason:
                print(f"  not drawn: {reason}")
                continue
            print("  " + ", ".join(f"{key} {value:.3g}" for key, value in numbers.items()))


if __name__ == "__main__":
    main()

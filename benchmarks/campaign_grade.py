"""Some broken inputs through the command `drupe grade` itself, on a batch of two ready meshes.

    python benchmarks/campaign_grade.py

Prints, for each, the exit status, what became of the broken fruit, and how far the other fruit's E is from
what it is in the sound batch: one bad fruit never costs its batch, and never changes a neighbour.
"""

import csv
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from recon.surface.mesh_file import read_mesh, write_mesh

SAMPLE = Path(__file__).resolve().parents[1] / "samples" / "data" / "two-fruits"
MOST_S = 900


def write_batch(root: Path) -> None:
    """Fruit A and B, the same ready mesh and grasps but for forces 0.2 % greater; nothing is wrong."""
    root.mkdir(parents=True)
    text = (SAMPLE / "batch.toml").read_text()
    (root / "batch.toml").write_text(text)
    (root / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,57.6,122\nB,57.6,122\n")
    for name in ("A", "B"):
        shutil.copytree(SAMPLE / "fruits" / "N01", root / "fruits" / name)
        for path in (root / "fruits" / name / "grasps").glob("*.h5"):
            with h5py.File(path, "r+") as file:
                file.attrs["fruit_id"] = name
                for pad in ("left", "right"):
                    file[f"pads/{pad}/force_N"][...] *= 1.002 if name == "B" else 1.0


def _text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        text = (root / name).read_text()
        assert old in text
        (root / name).write_text(text.replace(old, new, 1))

    return change


def _metres(root: Path) -> None:
    path = root / "fruits" / "B" / "fruit.ply"
    vertices, faces = read_mesh(path)
    write_mesh(path, vertices / 1000, faces)


def _recordings(field: str, number: float, names: tuple[str, ...]) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        for name in names:
            with h5py.File(root / "fruits" / "B" / "grasps" / name, "r+") as file:
                file[field][(0,) * file[field].ndim] = number

    return change


def _pipe(root: Path) -> None:
    path = root / "fruits" / "B" / "grasps" / "grasp-1.h5"
    path.unlink()
    os.mkfifo(path)


def _device(root: Path) -> None:
    (root / "batch.toml").unlink()
    (root / "batch.toml").symlink_to("/dev/zero")


BOTH = ("grasp-1.h5", "grasp-2.h5")
BROKEN: dict[str, Callable[[Path], None]] = {
    "fruits.csv: B's height in cm": _text("fruits.csv", "B,57.6", "B,5.76"),
    "fruits.csv: B's mass in kg": _text("fruits.csv", "B,57.6,122", "B,57.6,0.122"),
    "fruits.csv: all heights in cm": _text("fruits.csv", "A,57.6,122\nB,57.6", "A,5.76,122\nB,5.76"),
    "batch.toml: limits in kPa": _text("batch.toml", "E_max_MPa = 0.3", "E_max_MPa = 300"),
    "batch.toml: gel_scale_sd = 1e300": _text("batch.toml", "[sensor]", "[sensor]\ngel_scale_sd = 1e300"),
    "batch.toml: a link to /dev/zero": _device,
    "fruit.ply of B in metres": _metres,
    "recordings of B: rest_mm 1e300": _recordings("pads/left/rest_mm", 1e300, BOTH),
    "one recording of B: force_N nan": _recordings("pads/left/force_N", np.nan, BOTH[:1]),
    "one recording of B: a named pipe": _pipe,
}


def grade(root: Path) -> tuple[int, dict[str, dict[str, str]], str]:
    """Exit status, the ranking's rows by fruit, and the last line of what was said."""
    command = [str(Path(sys.executable).with_name("drupe")), "grade", str(root), "--jobs", "1"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=MOST_S, check=False)
    said = (ran.stderr.strip().splitlines() or [""])[-1].replace(f"{root}/", "")
    if "Traceback" in ran.stderr + ran.stdout:
        said = f"TRACEBACK {said}"
    ranking = root / "results" / "ranking.csv"
    rows: dict[str, dict[str, str]] = {}
    if ran.returncode != 2 and ranking.is_file():
        with ranking.open(newline="") as file:
            rows = {row["fruit_id"]: row for row in csv.DictReader(file)}
    return ran.returncode, rows, said


def main() -> None:
    """Prints the table."""
    with tempfile.TemporaryDirectory() as scratch:
        sound = Path(scratch) / "sound"
        write_batch(sound)
        status, rows, _ = grade(sound)
        E_MPa = float(rows["A"]["E_MPa"])
        print(f"sound: exit status {status}, E {E_MPa:.4g} MPa\n")
        print("| broken | exit status | B | A's E over sound |")
        print("|---|---:|---|---:|", flush=True)
        for k, (name, change) in enumerate(BROKEN.items()):
            root = Path(scratch) / str(k)
            shutil.copytree(sound, root, symlinks=True)  # with results: what is unchanged is kept
            change(root)
            status, rows, said = grade(root)
            if not rows:
                print(f"| {name} | {status} | batch refused: {said} | |", flush=True)
                continue
            own, other = rows["B"], rows["A"]
            became = own["reason"] if own["outcome"] != "graded" else f"graded, E {own['E_MPa']} MPa"
            share = float(other["E_MPa"]) / E_MPa if other["E_MPa"] else float("nan")
            print(f"| {name} | {status} | {own['outcome']}: {became} | {share:.4f} |", flush=True)


if __name__ == "__main__":
    main()

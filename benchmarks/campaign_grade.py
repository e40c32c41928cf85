"""Some broken inputs through the command `drupe grade` itself, on a batch of two ready meshes.

    python benchmarks/campaign_grade.py

Prints, for each, the exit status, what became of the broken fruit, and how far the other fruit's E is from
what it is in the sound batch: one bad fruit never costs its batch, and never changes a neighbour. Each case
states what it expects; the last column says whether that came.
"""

import argparse
import csv
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
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


def _scaled(**factors: float) -> Callable[[Path], None]:
    """Fields and attributes of both pads of B's recordings times a factor."""

    def change(root: Path) -> None:
        for name in BOTH:
            with h5py.File(root / "fruits" / "B" / "grasps" / name, "r+") as file:
                for pad in file["pads"].values():
                    for field, factor in factors.items():
                        if field in pad.attrs:
                            pad.attrs[field] *= factor
                        else:
                            pad[field][...] *= factor

    return change


def _gain(root: Path) -> None:
    for name in BOTH:
        with h5py.File(root / "fruits" / "B" / "grasps" / name, "r+") as file:
            file["pads/left/force_N"][...] *= 1.04


def _pipe(root: Path) -> None:
    path = root / "fruits" / "B" / "grasps" / "grasp-1.h5"
    path.unlink()
    os.mkfifo(path)


def _device(root: Path) -> None:
    (root / "batch.toml").unlink()
    (root / "batch.toml").symlink_to("/dev/zero")


BOTH = ("grasp-1.h5", "grasp-2.h5")


@dataclass(frozen=True, kw_only=True)
class BrokenBatch:
    """A change of the sound batch, and what must come of it.

    `expects`: a regular expression for B's outcome and reason, or for the refusal of the batch; for a graded
    fruit the text is "graded: MESSAGES", with its doubts and all that the command printed. `E_over_sound`:
    B's E over that of the sound batch, within `within`. `most_sd`: the most standard deviations by which B's
    E may differ from the sound one. `all_fruit`: the change is of A too.
    """

    change: Callable[[Path], None]
    expects: str
    E_over_sound: float | None = None
    within: float = 0.01
    most_sd: float | None = None
    all_fruit: bool = False


BROKEN: dict[str, BrokenBatch] = {
    "fruits.csv: B's height in cm": BrokenBatch(
        change=_text("fruits.csv", "B,57.6", "B,5.76"), expects=r"height_mm 5\.76: .* in cm \(57\.6 mm\)"
    ),
    "fruits.csv: B's mass in kg": BrokenBatch(
        change=_text("fruits.csv", "B,57.6,122", "B,57.6,0.122"),
        expects=r"mass_g 0\.122: .* in kg \(122 g\)",
    ),
    "fruits.csv: all heights in cm": BrokenBatch(
        change=_text("fruits.csv", "A,57.6,122\nB,57.6", "A,5.76,122\nB,5.76"),
        expects=r"height_mm of all 2 fruit is 5\.76.* in cm \(57\.6 mm\)",
    ),
    "batch.toml: limits in kPa": BrokenBatch(
        change=_text("batch.toml", "E_max_MPa = 0.3", "E_max_MPa = 300"),
        expects=r"batch\.toml: .*E_max_MPa must grow",
    ),
    "batch.toml: gel_scale_sd = 1e300": BrokenBatch(
        change=_text("batch.toml", "[sensor]", "[sensor]\ngel_scale_sd = 1e300"),
        expects=r"batch\.toml: .*gel_scale_sd.*at most 0\.5",
    ),
    "ship = false on the softest class": BrokenBatch(
        change=_text("batch.toml", "E_max_MPa = 0.3", "E_max_MPa = 0.3\nship = false"), expects=r"MPa, ship:"
    ),
    "ship = false on B's class": BrokenBatch(
        change=_text("batch.toml", "E_max_MPa = 0.9", "E_max_MPa = 0.9\nship = false"), expects=r"MPa, hold:"
    ),
    "ship = true on the firmest class": BrokenBatch(
        change=_text("batch.toml", 'name = "firm"', 'name = "firm"\nship = true'), expects=r"MPa, ship:"
    ),
    "inspect_below_p = 1": BrokenBatch(
        change=_text("batch.toml", "[sensor]", "[grading]\ninspect_below_p = 1\n\n[sensor]"),
        expects=r"MPa, inspect: missing physics suspected: .*\(p = 0\.\d+\), E is 0\.\d+",
    ),
    "certainty = 90": BrokenBatch(
        change=_text("batch.toml", "[sensor]", "[grading]\ncertainty = 90\n\n[sensor]"),
        expects=r'batch\.toml: "grading\.certainty": found 90; .* in per cent \(0\.9\)',
    ),
    "the left pad of B reads 4 % too much": BrokenBatch(
        change=_gain,
        expects=r"MPa, inspect: missing physics suspected: sensor gain.* \(p = .*, E is .* and .* with it",
        E_over_sound=1.02,
    ),
    "a control chart in another folder": BrokenBatch(
        change=_text("batch.toml", "[sensor]", '[reference]\nchart = "/tmp/x.csv"\n\n[sensor]'),
        expects=r'batch\.toml: "reference\.chart": found .*; expected a file in the batch',
    ),
    "batch.toml: a link to /dev/zero": BrokenBatch(change=_device, expects=r"batch\.toml: is a device"),
    "fruit.ply of B in metres": BrokenBatch(change=_metres, expects=r"is it in m \(57\.58 mm\)"),
    "recordings of B: rest_mm 1e300": BrokenBatch(
        change=_recordings("pads/left/rest_mm", 1e300, BOTH), expects=r"grasp-1\.h5: pads/left/rest_mm: found"
    ),
    "one recording of B: force_N nan": BrokenBatch(
        change=_recordings("pads/left/force_N", np.nan, BOTH[:1]),
        expects=r"grasp-1\.h5.*force_N",
        E_over_sound=1.0,
        within=0.02,
    ),
    "one recording of B: a named pipe": BrokenBatch(
        change=_pipe, expects=r"grasp-1\.h5.*pipe", E_over_sound=1.0, within=0.02
    ),
    "recordings of B: force x 1.079": BrokenBatch(
        change=_scaled(force_N=1.079), expects="graded", most_sd=2.0
    ),
    "recordings of B: force x 0.927": BrokenBatch(
        change=_scaled(force_N=0.927), expects="graded", most_sd=2.0
    ),
    "recordings of B: picture scale 10 % wrong, forces computed from it": BrokenBatch(
        change=_scaled(displacement_mm=1.1, force_N=1.1), expects="graded", most_sd=2.0
    ),
    "recordings of B: gel stiffness and force x 2": BrokenBatch(
        change=_scaled(force_N=2, gel_kn_MPa_per_mm=2, gel_kt_MPa_per_mm=2),
        expects=r"gel_kn_MPa_per_mm is 0\.44, and the sensor model .* 0\.22",
        most_sd=2.0,
    ),
    "batch.toml: poisson_ratio = 0.30": BrokenBatch(
        change=_text("batch.toml", "poisson_ratio = 0.45", "poisson_ratio = 0.30"),
        expects=r"poisson_ratio: found 0\.3 in batch\.toml, expected 0\.45 ± 0\.015",
        most_sd=2.0,
        all_fruit=True,
    ),
    "batch.toml: category plum": BrokenBatch(
        change=_text("batch.toml", '"nectarine"', '"plum"'),
        expects=r"category: the mesh is 60 mm large in the mean, which fits a nectarine",
        most_sd=2.0,
        all_fruit=True,
    ),
}


def grade(root: Path) -> tuple[int, dict[str, dict[str, str]], str]:
    """Exit status, the ranking's rows by fruit, and all that was printed, in one line."""
    command = [str(Path(sys.executable).with_name("drupe")), "grade", str(root), "--jobs", "1"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=MOST_S, check=False)
    printed = " ".join((ran.stdout + " " + ran.stderr).replace(f"{root}/", "").split())
    ranking = root / "results" / "ranking.csv"
    rows: dict[str, dict[str, str]] = {}
    if ran.returncode != 2 and ranking.is_file():
        with ranking.open(newline="") as file:
            rows = {row["fruit_id"]: row for row in csv.DictReader(file)}
    return ran.returncode, rows, printed


def judged(case: BrokenBatch, row: dict[str, str] | None, printed: str, sound_MPa: float) -> tuple[str, str]:
    """What became of B, and what is wrong with that; empty where it is as expected."""
    if row is None:
        became = f"batch refused: {printed[-600:]}"
    elif row["outcome"] != "graded":
        became = f"{row['outcome']}: {row['reason']}"
    else:
        became = f"graded, E {row['E_MPa']} ± {row['E_sd_MPa']} MPa, {row['decision']}: "
        became += " | ".join(text for text in (row["decision_reason"], row["doubts"], row["reason"]) if text)
    if "Traceback" in printed:
        return became, "a traceback"
    searched = became if row is not None and row["outcome"] != "graded" else f"{became} {printed}"
    if not re.search(case.expects, searched):
        return became, f"expected {case.expects!r}"
    if case.E_over_sound is not None:
        share = float(row["E_MPa"]) / sound_MPa if row is not None and row["E_MPa"] else float("nan")
        if not abs(share - case.E_over_sound) <= case.within:
            return became, f"E over sound is {share:.4f}, expected {case.E_over_sound} ± {case.within}"
    if case.most_sd is not None:
        off = abs(float(row["E_MPa"]) - sound_MPa) if row is not None and row["E_MPa"] else float("nan")
        if not off <= case.most_sd * float(row["E_sd_MPa"] if row is not None else "nan"):
            return became, f"E is {off:.4f} MPa off, expected {case.most_sd} standard deviations at most"
    return became, ""


def main() -> None:
    """Prints the table; exit status 1 where a case is not as expected."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="", help="Only cases whose name contains this text.")
    only = parser.parse_args().only
    failures = 0
    with tempfile.TemporaryDirectory() as scratch:
        sound = Path(scratch) / "sound"
        write_batch(sound)
        status, rows, _ = grade(sound)
        sound_MPa = {name: float(rows[name]["E_MPa"]) for name in ("A", "B")}
        print(f"sound: exit status {status}, E {sound_MPa['A']:.4g} MPa\n")
        print("| broken | exit status | B | A's E over sound | as expected |")
        print("|---|---:|---|---:|---|", flush=True)
        for k, (name, case) in enumerate(BROKEN.items()):
            if only not in name:
                continue
            root = Path(scratch) / str(k)
            shutil.copytree(sound, root, symlinks=True)  # with results: what is unchanged is kept
            case.change(root)
            status, rows, printed = grade(root)
            became, wrong = judged(case, rows.get("B"), printed, sound_MPa["B"])
            share = float(rows["A"]["E_MPa"]) / sound_MPa["A"] if rows.get("A", {}).get("E_MPa") else np.nan
            if rows and not case.all_fruit and not abs(share - 1) < 0.01:
                wrong = wrong or "the other fruit changed"
            failures += bool(wrong)
            print(f"| {name} | {status} | {became} | {share:.4f} | {wrong or 'yes'} |", flush=True)
    print(f"\n{failures} failures")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()

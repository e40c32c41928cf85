"""What becomes of real gel clips whose own first frame is taken for the untouched gel.

    python benchmarks/gel_reference_ends.py FOLDER --out CSV [--half even|odd] [--most N] [--reference KEY]

FOLDER and halves as in gel_lattice_slips.py. Each clip becomes a press with one pad: a slab of 3 mm, 0.25 MPa
and nu 0.48 with markers 2 mm apart (assumed; the set says nothing of its gels), every third frame of it. Of
each it is said how the contact ends: a peak force, or the failure. KEY is what grasp.toml says of the
reference (reference_frames = [0, 1]).
"""

import argparse
import csv
import tempfile
from pathlib import Path

import cv2
import numpy as np
from gel_lattice_slips import clips_of
from gel_video import frames_of

from tactile.contact import find_contact
from tactile.from_frames import recording_of
from tactile.io.raw_grasp import read_raw_grasp
from tactile.markers.tracking import reference_of
from tactile.tactile_failure import TactileFailure

EVERY, FRAMES = 3, 60
"""Of the frames every third one, and so many of these at most: a tracker's frame takes 0.03 s."""
PITCH_MM, DEPTH_MM = 2.0, 16.0

SENSOR = """
kind = "markers-mono"
name = "printed dots"
[gel]
thickness_mm = 3.0
E_MPa = 0.25
nu = 0.48
[camera]
image_px = [{width}, {height}]
focal_px = [{focal}, {focal}]
centre_px = [{x}, {y}]
gel_from_camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -{depth}], [0, 0, 0, 1]]
"""
GRASP = """
fruit_id = "object"
category = "phantom"
loading = "press"
pose_aperture_mm = 0.0
[pads.tip]
sensor = "tip.toml"
pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 10], [0, 0, 0, 1]]
{reference}
"""


def press_of(frames: list[np.ndarray], folder: Path, reference: str) -> None:
    """The raw press with these frames."""
    height, width = frames[0].shape[:2]
    spacing = reference_of(frames[0], source="first frame").lattice.spacing_px
    (folder / "tip").mkdir(parents=True)
    for t, frame in enumerate(frames):
        cv2.imwrite(str(folder / "tip" / f"frame_{t:06d}.png"), frame)
    described = {
        "width": width, "height": height, "focal": spacing / PITCH_MM * DEPTH_MM, "depth": DEPTH_MM,
        "x": (width - 1) / 2, "y": (height - 1) / 2,
    }  # fmt: skip
    (folder / "tip.toml").write_text(SENSOR.format(**described))
    (folder / "grasp.toml").write_text(GRASP.format(reference=reference))
    rows = [f"{0.12 * t:.3f},{0.02 * t:.3f}" for t in range(len(frames))]
    (folder / "log.csv").write_text("\n".join(["time_s,aperture_mm", *rows]) + "\n")


def end_of(frames: list[np.ndarray], reference: str) -> dict[str, object]:
    """The peak normal force, or why there is none."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "press"
        try:
            press_of(frames, folder, reference)
            made = recording_of(read_raw_grasp(folder))
            contact = find_contact(made.recording, source="press")
        except TactileFailure as failure:
            return {"code": failure.problem.value, "says": str(failure)}
    peak = float(contact.pads[0].total_normal_N.max())
    doubts = [note for note in made.notes if "reference" in note]
    return {"code": "", "peak_N": round(peak, 3), "says": " ".join(doubts)}


def main() -> None:
    """One row per clip, and how many ended how."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--half", choices=("even", "odd"))
    parser.add_argument("--most", type=int, default=10_000)
    parser.add_argument("--reference", default="reference_frames = [0, 1]")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    fields = ["clip", "sha256", "code", "peak_N", "says"]
    count: dict[str, int] = {}
    clips = list(clips_of(given.folder, given.half))
    chosen = clips[:: max(1, len(clips) // given.most)][: given.most]
    with given.out.open("w", newline="") as file:
        table = csv.DictWriter(file, fields, lineterminator="\n")
        table.writeheader()
        for digest, path in chosen:
            frames = list(frames_of(path))[::EVERY][:FRAMES]
            row = end_of(frames, given.reference)
            table.writerow({"clip": str(path.relative_to(given.folder)), "sha256": digest[:12]} | row)
            file.flush()
            count[str(row["code"])] = count.get(str(row["code"]), 0) + 1
    print(f"{len(chosen)} clips: {count}")


if __name__ == "__main__":
    main()

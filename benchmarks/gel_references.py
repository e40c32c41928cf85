"""References of real gel clips: prints noticed on them, false alarms, and references estimated without one.

    python benchmarks/gel_references.py FOLDER --half even|odd [--out CSV]

FOLDER and halves as in gel_lattice_slips.py: thresholds come from the even half, the odd one was scored once.
gel_references.csv beside this file says by eye what each clip's first frame is: an `empty` gel, one that
bears a `print`, one that is `loaded` throughout the clip though no print was seen (its gel lies on the
object's smooth side), or `unclear`.

Prints: of the first frames, how many show one (tactile.reference_print), by what was seen by eye.
Estimates: of clips whose first frame is empty, the untouched gel is estimated from each of 14 later frames
that show a print, and held against the first frame; with the lens free, and with a description of the sensor
(the smooth lens of the empty frame, shifted by 2 px, as a calibrated camera would have it).
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from gel_lattice_slips import clips_of
from gel_video import frames_of
from scipy.spatial import cKDTree

from tactile.markers.smooth_lattice import fitted_lens, lattice_places
from tactile.markers.tracking import ReferenceMarkers, reference_of
from tactile.pad_reference import EstimatedReference, estimated_reference
from tactile.reference_print import SURE, shown_print
from tactile.tactile_failure import TactileFailure

LABELS = Path(__file__).with_suffix(".csv")
TRIED = 14
"""Frames of a clip from which its empty gel is estimated."""
EMPTY_FRAMES = 2
"""Whose mean is the empty gel: the object comes in the third frame of some clips."""
SAME = 0.4
"""Of the spacing: two markers nearer than this are one."""
PITCH_UM = 2000.0
"""Taken, not known: the set says nothing of the gels' pitch."""


def rgb(frame: np.ndarray) -> np.ndarray:
    """OpenCV's blue, green, red the other way round."""
    return np.ascontiguousarray(frame[..., ::-1])


def errors_of(estimate: EstimatedReference, truth_px: np.ndarray, spacing: float) -> dict[str, np.ndarray]:
    """Errors in spacings of the unloaded places and of those below the print, and these over their sd."""
    away, which = cKDTree(truth_px).query(estimate.rest_px)
    same = np.asarray(away) < SAME * spacing
    off = (estimate.rest_px - truth_px[np.asarray(which)])[same]
    unloaded, sd = estimate.unloaded[same], estimate.sd_px[same]
    return {
        "unloaded": off[unloaded] / spacing,
        "below": off[~unloaded] / spacing,
        "unloaded_over_sd": off[unloaded] / sd[unloaded, None],
        "below_over_sd": off[~unloaded] / sd[~unloaded, None],
    }


def estimates(
    frames: list[np.ndarray], empty: ReferenceMarkers, rng: np.random.Generator
) -> list[tuple[str, dict[str, np.ndarray] | None]]:
    """Of each frame that shows a print: with which lens, and the errors (None: refused)."""
    truth_px = empty.lattice.rest_px
    grid, known = lattice_places(empty.lattice)
    lens_px = fitted_lens(grid[known], truth_px[known], empty.shape).places_px(grid[known])
    answers: list[tuple[str, dict[str, np.ndarray] | None]] = []
    for t in np.unique(np.linspace(EMPTY_FRAMES + 1, len(frames) - 1, TRIED).astype(int)):
        frame = rgb(frames[t])
        try:
            markers = reference_of(frame, source="loaded")
        except TactileFailure:
            continue
        if shown_print(frame, markers).evidence < 1.0:
            continue
        lattice = markers.lattice
        ideal, on_grid = lattice_places(lattice)
        away, which = cKDTree(lens_px).query(lattice.rest_px)
        described_px = lens_px[np.asarray(which)] + rng.normal(scale=2.0, size=2)
        near = np.asarray(away) < SAME * lattice.spacing_px
        for name, places_px, has in (("lens", None, on_grid), ("described", described_px, near)):
            try:
                estimate = estimated_reference(lattice, ideal, has, described_px=places_px, source="loaded")
            except TactileFailure:
                answers.append((name, None))
                continue
            answers.append((name, errors_of(estimate, truth_px, lattice.spacing_px)))
        loaded = np.asarray(cKDTree(truth_px).query(lattice.rest_px)[1])
        off = (lattice.rest_px - truth_px[loaded]) / lattice.spacing_px
        answers.append(("frame itself", {"below": off[np.linalg.norm(off, axis=1) < SAME]}))
    return answers


def root_mean_square(values: list[np.ndarray]) -> float:
    """Over all rows of all arrays; nan of none."""
    rows = np.concatenate([np.zeros((0, 2)), *values])
    return float(np.sqrt((rows**2).mean())) if len(rows) else float("nan")


def main() -> None:
    """Counts of prints by label, and errors of the estimates."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", choices=("even", "odd"))
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    label = pd.read_csv(LABELS, dtype=str).set_index("sha256")["first_frame"].to_dict()
    rows: list[dict[str, object]] = []
    answers: dict[str, list[dict[str, np.ndarray] | None]] = {}
    clips, rng = 0, np.random.default_rng(22)
    for digest, path in clips_of(given.folder, given.half):
        frames = list(frames_of(path))
        said = label.get(digest[:12], "")
        try:
            first = rgb(frames[0])
            shown = shown_print(first, reference_of(first, source="first frame"))
        except TactileFailure as failure:
            rows.append({"sha256": digest[:12], "label": said, "failure": str(failure)})
            continue
        rows.append(
            {"sha256": digest[:12], "label": said, "bulge": shown.bulge, "shading": shown.shading,
             "evidence": shown.evidence, "failure": ""}
        )  # fmt: skip
        if said == "empty":
            mean = np.mean(frames[:EMPTY_FRAMES], axis=0).round().astype(np.uint8)
            answered = estimates(frames, reference_of(rgb(mean), source="empty"), rng)
            clips += bool(answered)
            for name, answer in answered:
                answers.setdefault(name, []).append(answer)
    for name in ("empty", "print", "loaded", "unclear"):
        values = [float(str(row["evidence"])) for row in rows if row["label"] == name and not row["failure"]]
        if values:
            noticed, sure = sum(v >= 1.0 for v in values), sum(v >= SURE for v in values)
            print(f"{name}: {len(values)}, noticed {noticed}, of them sure {sure}; largest {max(values):.2f}")
    print(f"estimates from {clips} clips")
    for name, errors in answers.items():
        good = [frame_errors for frame_errors in errors if frame_errors is not None]
        said_of = [f"{name}: {len(errors)} frames, {len(errors) - len(good)} refused"]
        for part in ("unloaded", "below"):
            if any(part in frame_errors for frame_errors in good):
                size = root_mean_square([frame_errors[part] for frame_errors in good if part in frame_errors])
                over = root_mean_square(
                    [
                        frame_errors[f"{part}_over_sd"]
                        for frame_errors in good
                        if f"{part}_over_sd" in frame_errors
                    ]
                )
                said_of.append(f"{part} {size:.3f} spacings ({PITCH_UM * size:.0f} um), over sd {over:.2f}")
        print("; ".join(said_of))
    if given.out is not None:
        pd.DataFrame(rows).to_csv(given.out, index=False)


if __name__ == "__main__":
    main()

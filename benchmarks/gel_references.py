"""References of real gel clips: prints noticed on them, and false alarms.

    python benchmarks/gel_references.py FOLDER --half even|odd|all [--out CSV]

FOLDER and halves as in gel_lattice_slips.py: thresholds come from the even half, the odd one was scored once.
gel_references.csv beside this file says by eye what each clip's first frame is: an `empty` gel, one that
bears a `print`, one that is `loaded` throughout the clip though no print was seen (its gel lies on the
object's smooth side), or `unclear`.

Prints: of the first frames, how many show one (tactile.reference_print), by what was seen by eye.
"""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from gel_lattice_slips import clips_of
from gel_video import frames_of
from script import Half, run

from tactile.markers.tracking import reference_of
from tactile.reference_print import SURE, shown_print
from tactile.tactile_failure import TactileFailure

COLUMNS = ["sha256", "label", "bulge", "shading", "evidence", "failure"]
LABELS = Path(__file__).with_suffix(".csv")


def main(folder: Path, half: Half = "all", out: Path | None = None) -> None:
    """Counts of prints by label."""
    cv2.setNumThreads(1)
    label = pd.read_csv(LABELS, dtype=str).set_index("sha256")["first_frame"].to_dict()
    rows: list[dict[str, object]] = []
    for digest, path in clips_of(folder, half):
        frames = list(frames_of(path))
        row = {"sha256": digest[:12], "label": label.get(digest[:12], ""), "failure": ""}
        try:
            first = np.ascontiguousarray(frames[0][..., ::-1])  # OpenCV has blue first
            shown = shown_print(first, reference_of(first, source="first frame"))
        except TactileFailure as failure:
            rows.append(row | {"failure": str(failure)})
        else:
            rows.append(row | {name: getattr(shown, name) for name in ("bulge", "shading", "evidence")})
    table = pd.DataFrame(rows, columns=COLUMNS)
    for name in ("empty", "print", "loaded", "unclear"):
        values = table["evidence"][(table["label"] == name) & (table["failure"] == "")]
        if len(values):
            noticed, sure = (values >= 1.0).sum(), (values >= SURE).sum()
            print(
                f"{name}: {len(values)}, noticed {noticed}, of them sure {sure}; largest {values.max():.2f}"
            )
    if out is not None:
        table.to_csv(out, index=False)


if __name__ == "__main__":
    run(main)

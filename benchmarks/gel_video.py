"""Markers in real gel videos: found, and followed forwards and backwards.

    python benchmarks/gel_video.py FOLDER --out DIR

FOLDER holds `<fruit>/<trial>/camera_<k>.avi`, a `slip.txt` beside the clips of a trial labelled "slip" (the
data set of github.com/amitparag/Incipient-Slip-Detection, BSD-2-Clause). No clip starts unloaded: markers are
followed from the clip's first frame, loaded or not. The picture shows their motion from the empty gel. That
gel is the mean of the last frames of a clip of the same camera whose fruit was dropped.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
import typer
from script import run

from tactile.markers.marker_detection import inside
from tactile.markers.tracking import ReferenceMarkers, reference_of, track

EMPTY_FRAMES = 25
DROPPED = "avocado_real/exp_num_1"


def frames_of(clip: Path) -> Iterator[np.ndarray]:
    """Frames as the file holds them."""
    video = cv2.VideoCapture(str(clip))
    while True:
        more, frame = video.read()
        if not more:
            return
        yield frame


def followed(frames: list[np.ndarray]) -> dict[str, float]:
    """Followed from the clip's first frame, forwards and backwards."""
    reference = reference_of(frames[0], source="first frame")
    start = time.process_time()
    position = track(reference, frames)
    seconds = time.process_time() - start
    backward = track(reference, frames[::-1])[::-1]
    apart = np.linalg.norm(backward - position, axis=2)
    rest, radius = reference.lattice.rest_px, reference.look.radius_px
    visible = kept_in_view(reference, position)
    seen = np.isfinite(position[..., 0])
    return {
        "markers": len(rest),
        "radius_px": radius,
        "frames": len(frames),
        "frames_with_95_percent": float((seen.mean(axis=1) >= 0.95).mean()),
        "frames_with_95_percent_of_those_in_view": float(
            ((seen & visible).sum(axis=1) >= 0.95 * visible.sum(axis=1)).mean()
        ),
        "largest_motion_px": float(np.nanmax(np.linalg.norm(position - rest, axis=2))),
        "largest_step_px": float(np.nanmax(np.linalg.norm(np.diff(position, axis=0), axis=2))),
        "forward_backward_px_median": float(np.nanmedian(apart)),
        "forward_backward_px_99": float(np.nanquantile(apart, 0.99)),
        "identities_switched": int((apart > reference.lattice.spacing_px / 2).sum()),
        "frames_with_a_switch": int((apart > reference.lattice.spacing_px / 2).any(axis=1).sum()),
        "frames_per_second": len(frames) / seconds,
        "doubled_frames": int(doubled(position).sum()),
    }


def kept_in_view(reference: ReferenceMarkers, position: np.ndarray) -> np.ndarray:
    """Markers that are seen, or whose last seen place lies well inside the frame: the others have left it."""
    last = pd.DataFrame(position.reshape(len(position), -1)).ffill().to_numpy().reshape(-1, 2)
    margin = 2 * reference.look.radius_px
    well_inside = inside(np.nan_to_num(last), reference.shape, margin).reshape(position.shape[:2])
    return np.asarray(np.isfinite(position[..., 0]) | well_inside)


def doubled(position: np.ndarray) -> np.ndarray:
    """Frames in which no marker moved by a thousandth of a pixel: the camera's last frame written again."""
    step = np.nanmax(np.abs(np.diff(position, axis=0)), axis=(1, 2))
    return np.concatenate([[False], step < 1e-3])


def picture(clips: dict[str, tuple[np.ndarray, ReferenceMarkers, np.ndarray]], path: Path) -> None:
    """First frames with every marker's motion from the empty gel."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(clips), figsize=(4.2 * len(clips), 3.4), squeeze=False)
    for axis, (name, (frame, reference, position)) in zip(axes[0], clips.items(), strict=True):
        rest = reference.lattice.rest_px
        step = position - rest
        axis.imshow(frame[..., ::-1])
        axis.quiver(*rest.T, *step.T, color="yellow", angles="xy", scale_units="xy", scale=1, width=0.005)
        axis.plot(*position.T, "w.", markersize=2.5)
        axis.set_title(name, fontsize=9)
        axis.axis("off")
    figure.text(0.01, 0.01, "Frames: A. Parag, Incipient-Slip-Detection, BSD-2-Clause", fontsize=6)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main(folder: Path, out: Annotated[Path, typer.Option()]) -> None:
    """The table and the picture."""
    out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    empty: dict[str, ReferenceMarkers] = {}
    for clip in sorted(folder.glob(f"{DROPPED}/camera_*.avi")):
        last = list(frames_of(clip))[-EMPTY_FRAMES:]
        empty[clip.stem] = reference_of(np.mean(last, axis=0).round().astype(np.uint8), source="empty gel")
    rows: list[dict[str, object]] = []
    shown: dict[str, tuple[np.ndarray, ReferenceMarkers, np.ndarray]] = {}
    for clip in sorted(folder.glob("*/*/camera_*.avi")):
        name = str(clip.relative_to(folder).with_suffix(""))
        frames = list(frames_of(clip))
        slip = (clip.parent / "slip.txt").exists()
        rows.append({"clip": name, **followed(frames), "labelled_slip": slip})
        print(rows[-1], flush=True)
        if clip.stem == "camera_0" and "pear" not in name:
            first = track(empty[clip.stem], frames[:1])[0]
            shown[name] = (frames[0], empty[clip.stem], first)
    pd.DataFrame(rows).to_csv(out / "gel_video.csv", index=False, float_format="%.4g")
    picture(shown, out / "gel-markers.png")


if __name__ == "__main__":
    run(main)

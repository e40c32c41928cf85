"""Markers in real gel videos: found, followed forwards and backwards, and what sticks.

    python benchmarks/gel_video.py FOLDER --out DIR

FOLDER holds `<fruit>/<trial>/camera_<k>.avi`, a `slip.txt` beside the clips of a trial labelled "slip" (the
data set of github.com/amitparag/Incipient-Slip-Detection, BSD-2-Clause). No clip starts unloaded. Two
references are used and said: `own`, the clip's first frame, loaded or not; and `empty`, the mean of the last
frames of a clip of the same camera whose fruit was dropped (the one that changes least over its last third),
for contact and stick.
"""

import argparse
import csv
import json
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np

from tactile.markers.contrast import grey
from tactile.markers.marker_detection import inside
from tactile.markers.tracking import ReferenceMarkers, reference_of, track
from tactile.stick import stick_ratio

EMPTY_FRAMES = 25
CONTACT_PX = 0.8
"""A marker this far from its place on the empty gel is carried by a fruit; an empty gel's are within 0.5."""
FEWEST_CARRIED = 4
LAG = 5
DROPPED = "avocado_real/exp_num_1"


def frames_of(clip: Path) -> Iterator[np.ndarray]:
    """Frames as the file holds them."""
    video = cv2.VideoCapture(str(clip))
    while True:
        more, frame = video.read()
        if not more:
            return
        yield frame


def optical_flow_px(frames: list[np.ndarray], position: np.ndarray, every: int) -> np.ndarray:
    """Lucas-Kanade's motion of each marker between neighbouring frames less the tracker's: another method."""
    misses = []
    for t in range(0, len(frames) - 1, every):
        seen = np.isfinite(position[t : t + 2, :, 0]).all(axis=0)
        before, after = (grey(frame).astype(np.uint8) for frame in frames[t : t + 2])
        start = position[t, seen].astype(np.float32)[:, None]
        flow, good, _ = cv2.calcOpticalFlowPyrLK(before, after, start, None, winSize=(17, 17), maxLevel=2)
        back, good_back, _ = cv2.calcOpticalFlowPyrLK(after, before, flow, None, winSize=(17, 17), maxLevel=2)
        sound = (good & good_back)[:, 0].astype(bool) & (np.abs(back - start).max(axis=(1, 2)) < 0.5)
        misses.append(np.linalg.norm(flow[sound, 0] - position[t + 1, seen][sound], axis=1))
    return np.concatenate(misses)


def own_reference(frames: list[np.ndarray]) -> dict[str, float]:
    """Followed from the clip's first frame, forwards and backwards."""
    reference = reference_of(frames[0], source="first frame")
    start = time.process_time()
    position, quality = track(reference, frames)
    seconds = time.process_time() - start
    backward = track(reference, frames[::-1])[0][::-1]
    apart = np.linalg.norm(backward - position, axis=2)
    rest, radius = reference.lattice.rest_px, reference.look.radius_px
    visible = kept_in_view(reference, position)
    seen = np.isfinite(position[..., 0])
    flow = optical_flow_px(frames, position, every=5)
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
        "against_optical_flow_px_median": float(np.median(flow)),
        "against_optical_flow_px_95": float(np.quantile(flow, 0.95)),
        "quality_median": float(np.median(quality)),
        "frames_per_second": len(frames) / seconds,
        "doubled_frames": int(doubled(position).sum()),
    }


def kept_in_view(reference: ReferenceMarkers, position: np.ndarray) -> np.ndarray:
    """Markers that are seen, or whose last seen place lies well inside the frame: the others have left it."""
    last = position.copy()
    for t in range(1, len(last)):
        last[t] = np.where(np.isfinite(last[t]), last[t], last[t - 1])
    margin = 2 * reference.look.radius_px
    well_inside = inside(np.nan_to_num(last.reshape(-1, 2)), reference.shape, margin).reshape(last.shape[:2])
    return np.asarray(np.isfinite(position[..., 0]) | well_inside)


def noise_px(position: np.ndarray) -> float:
    """One coordinate's scatter about its mean over frames of a gel at rest, doubled frames left out.

    Differences of neighbouring frames would say too little: the codec repeats what it takes for still.
    """
    fresh = position[~doubled(position)]
    return float(np.sqrt(np.nanmean((fresh - np.nanmean(fresh, axis=0)) ** 2)))


def doubled(position: np.ndarray) -> np.ndarray:
    """Frames in which no marker moved by a thousandth of a pixel: the camera's last frame written again."""
    step = np.nanmax(np.abs(np.diff(position, axis=0)), axis=(1, 2))
    return np.concatenate([[False], step < 1e-3])


def against_empty(
    reference: ReferenceMarkers, frames: list[np.ndarray], noise: float
) -> tuple[dict[str, float], np.ndarray]:
    """Contact and stick, counted from the empty gel of the same camera."""
    position, _ = track(reference, frames)
    moved = np.linalg.norm(position - reference.lattice.rest_px, axis=2)
    carried = np.nan_to_num(moved) > CONTACT_PX
    carried &= carried.sum(axis=1, keepdims=True) >= FEWEST_CARRIED
    stick = stick_ratio(position, carried, noise=noise, lag=LAG)
    return {
        "carried_markers": float(carried.sum(axis=1).mean()),
        "stick_ratio": float(stick.ratio.mean()),
        "stick_ratio_lowest_in_contact": float(stick.ratio[carried.any(axis=1)].min(initial=1.0)),
        "frames_without_contact": float((~carried.any(axis=1)).mean()),
    }, stick.ratio


def dropped_and_back(frames: list[np.ndarray]) -> dict[str, float]:
    """After the drop the gel returns: its mean place in the middle of the clip against that at the end."""
    empty = np.mean(frames[-EMPTY_FRAMES:], axis=0).round().astype(np.uint8)
    reference = reference_of(empty, source="empty gel")
    position, _ = track(reference, frames)
    middle = slice(len(frames) // 2, len(frames) // 2 + EMPTY_FRAMES)
    off = np.nanmean(position[middle], axis=0) - reference.lattice.rest_px
    loaded = np.nanmedian(np.linalg.norm(position[0] - reference.lattice.rest_px, axis=1))
    return {
        "median_px_before_the_drop": float(loaded),
        "rms_px_from_the_empty_gel_later": float(np.sqrt((off**2).mean())),
        "largest_px": float(np.linalg.norm(off, axis=1).max()),
        "noise_px_of_one_frame": noise_px(position[middle]),
    }


def write_table(rows: dict[str, dict[str, object]], path: Path) -> None:
    """One row per clip."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, ["clip", *next(iter(rows.values()))], lineterminator="\n")
        table.writeheader()
        for name, row in rows.items():
            rounded = {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in row.items()}
            table.writerow({"clip": name} | rounded)


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


def stick_picture(ratios: dict[str, np.ndarray], path: Path) -> None:
    """Stick ratio over time, one line per clip."""
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(6.5, 3.2))
    for name, ratio in ratios.items():
        axis.plot(np.arange(len(ratio)) / 25.0, ratio, label=name, lw=1)
    axis.set_xlabel("time, s")
    axis.set_ylabel("stick ratio")
    axis.legend(fontsize=6, ncol=2)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main() -> None:
    """Tables, JSON and pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    clips = sorted(given.folder.glob("*/*/camera_*.avi"))
    empty: dict[str, ReferenceMarkers] = {}
    noise: dict[str, float] = {}
    answer: dict[str, dict[str, object]] = {}
    shown: dict[str, tuple[np.ndarray, ReferenceMarkers, np.ndarray]] = {}
    ratios: dict[str, np.ndarray] = {}
    for clip in [c for c in clips if str(c.relative_to(given.folder)).startswith(DROPPED)]:
        frames = list(frames_of(clip))
        mean = np.mean(frames[-EMPTY_FRAMES:], axis=0).round().astype(np.uint8)
        empty[clip.stem] = reference_of(mean, source="empty gel")
        back = dropped_and_back(frames)
        noise[clip.stem] = back["noise_px_of_one_frame"]
        answer[f"{clip.relative_to(given.folder)} after the drop"] = dict(back)
        print(clip.relative_to(given.folder), {k: round(v, 3) for k, v in back.items()}, flush=True)
    for clip in clips:
        name = str(clip.relative_to(given.folder).with_suffix(""))
        frames = list(frames_of(clip))
        own = own_reference(frames)
        contact, ratio = against_empty(empty[clip.stem], frames, noise[clip.stem])
        slip = (clip.parent / "slip.txt").exists()
        answer[name] = {**own, **contact, "labelled_slip": slip}
        ratios[name + (" (slip)" if slip else "")] = ratio
        print(
            name,
            {k: round(float(v), 3) for k, v in (own | contact).items()},
            "SLIP" if slip else "",
            flush=True,
        )
        if clip.stem == "camera_0" and "pear" not in name:
            first = track(empty[clip.stem], frames[:1])[0][0]
            shown[name] = (frames[0], empty[clip.stem], first)
    (given.out / "gel_video.json").write_text(json.dumps(answer, indent=1) + "\n")
    write_table({name: row for name, row in answer.items() if "markers" in row}, given.out / "gel_video.csv")
    picture(shown, given.out / "gel-markers.png")
    stick_picture(ratios, given.out / "gel-stick.png")


if __name__ == "__main__":
    main()

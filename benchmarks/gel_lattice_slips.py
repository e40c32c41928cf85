"""Frames of real gel videos in which the tracked markers are off by a pitch of their lattice.

    python benchmarks/gel_lattice_slips.py FOLDER --out CSV [--half even|odd|all]

FOLDER holds clips `camera_<k>.avi` at any depth (the data set of
github.com/amitparag/Incipient-Slip-Detection, BSD-2-Clause); copies of a clip count once. Halves go by the
clip's SHA-256: one to work on, one to score.

The detector shares no code with the tracker. Where the gel looks as it did in the first frame, it is not
loaded, and its dots are where the nearest dot is: the patch of the first frame around each marker is looked
for within half a pitch (normalised cross-correlation of all three colours), and the gel about the dot must
have kept its colours. A frame slips where more than half of these markers are tracked more than half a pitch
away from there.
"""

import hashlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import pandas as pd
import typer
from gel_video import frames_of
from script import Half, in_half, run

from tactile.markers.marker_detection import spacing_of
from tactile.markers.matching import UNSURE
from tactile.markers.tracking import follow, labelled_places, reference_of
from tactile.tactile_failure import TactileFailure

PATCH, REACH = 0.42, 0.5
"""Half a patch's side and how far it is looked for, in pitches: beyond half a pitch is the next dot."""
LIKE = 0.9
"""Least correlation of an unloaded patch with itself in another frame (codec noise leaves 0.95 and more)."""
COLOUR = 6.0
"""Grey levels of 255 by which an unloaded gel's colours may differ about the dot; light changes by 5 to 15
from one dot to the next."""
STAYS = 0.3
"""Pitches by which the dot of an unloaded place may have moved."""
FEWEST = 4
"""Unloaded markers that a frame is judged by, at least."""


def unloaded_motion(
    first: np.ndarray, now: np.ndarray, rest_px: np.ndarray, pitch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Motion (px) of each marker's patch within half a pitch, and whether the gel about it is unloaded."""
    half, reach = round(PATCH * pitch), round(REACH * pitch)
    height, width = first.shape[:2]
    motion, unloaded = np.zeros_like(rest_px), np.zeros(len(rest_px), dtype=bool)
    for n, (x, y) in enumerate(np.rint(rest_px).astype(int)):
        side = half + reach
        if not (side <= x < width - side and side <= y < height - side):
            continue
        patch = first[y - half : y + half + 1, x - half : x + half + 1]
        there = now[y - side : y + side + 1, x - side : x + side + 1]
        score = cv2.matchTemplate(there, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, (across, down) = cv2.minMaxLoc(score)
        motion[n] = across - reach, down - reach
        matched = there[down : down + 2 * half + 1, across : across + 2 * half + 1]
        ring = np.abs(matched.astype(np.int16) - patch).mean(axis=2)
        about = np.hypot(*np.mgrid[-half : half + 1, -half : half + 1]) > 0.3 * pitch
        unloaded[n] = best > LIKE and np.hypot(*motion[n]) < STAYS * pitch and np.median(ring[about]) < COLOUR
    return motion, unloaded


def judged(frames: list[np.ndarray]) -> dict[str, object]:
    """The clip followed from its first frame: frames, those with enough unloaded markers, of them those that
    slip and those with single markers off; frames that tracking itself is unsure of; share of the markers
    found; frames in a CPU second.
    """
    reference = reference_of(frames[0], source="first frame")
    rest = reference.lattice.rest_px
    pitch = spacing_of(rest)
    start = time.process_time()
    rows = list(follow(reference, frames))
    position = labelled_places(reference, rows)
    seconds = time.process_time() - start
    slipped, partly, count = [], 0, 0
    for t in range(1, len(frames)):
        motion, unloaded = unloaded_motion(frames[0], frames[t], rest, pitch)
        seen = unloaded & np.isfinite(position[t, :, 0])
        if unloaded.sum() < FEWEST:
            continue
        count += 1
        off = np.linalg.norm(position[t] - rest - motion, axis=1) > 0.5 * pitch
        if (off & seen).sum() > 0.5 * max(seen.sum(), FEWEST):
            slipped.append(t)
        elif (off & seen).any():
            partly += 1
    return {
        "frames": len(frames),
        "judged": count,
        "slipped": len(slipped),
        "first_slip": slipped[0] if slipped else "",
        "partly": partly,
        "uncertain": sum(row.certainty < UNSURE for row in rows),
        "kept": round(float(np.isfinite(position[..., 0]).mean()), 4),
        "frames_per_s": round(len(frames) / seconds, 1),
        "failure": "",
    }


def clips_of(folder: Path, half: Half) -> Iterator[tuple[str, Path]]:
    """Clips without copies, in an order that is their digests'."""
    known: dict[str, Path] = {}
    for path in sorted(folder.rglob("camera_*.avi"), key=lambda p: (len(p.parts), str(p))):
        known.setdefault(hashlib.sha256(path.read_bytes()).hexdigest(), path)
    for digest, path in sorted(known.items()):
        if in_half(int(digest[:8], 16), half):
            yield digest, path


def main(folder: Path, out: Annotated[Path, typer.Option()], half: Half = "all") -> None:
    """One row per clip, and sums."""
    cv2.setNumThreads(1)
    rows = []
    for digest, path in clips_of(folder, half):
        name = str(path.relative_to(folder).with_suffix(""))
        frames = list(frames_of(path))
        row: dict[str, object] = {"clip": name, "sha256": digest[:12]}
        try:
            row |= judged(frames)
        except TactileFailure as failure:
            row |= {"failure": str(failure)}
        rows.append(row)
        if row["failure"] or row["slipped"] or row["partly"] or row["uncertain"]:
            print(row, flush=True)
    table = pd.DataFrame(rows)
    table.to_csv(out, index=False)
    good = table[table["failure"] == ""]
    total = good[["frames", "judged", "slipped", "partly"]].sum().astype(int).to_dict()
    clips = (good[["slipped", "partly", "uncertain"]] > 0).sum().to_dict()
    print(
        f"{len(table)} clips, {len(table) - len(good)} without an answer; {total}, in so many clips {clips}; "
        f"markers kept {good['kept'].mean():.4f}"
    )


if __name__ == "__main__":
    run(main)

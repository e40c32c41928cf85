"""Drawn jumps of a gel between two frames: how many leave markers a pitch off, and how many of them are said.

    python benchmarks/gel_lattice_jumps.py FIRST LAST

One jump for each seed from FIRST up to LAST: a lattice that goes on beyond the picture, so that no rim tells
it; a press somewhere in view that carries the gel 0.3 to 1.5 pitches and spreads it, fading over 35 to 110 px
(pitch 30 px); half of them blurred by 2.5 px while they move. Gels whose neighbours move apart by half a
pitch and more are counted by themselves.
"""

import argparse

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tactile.markers.matching import UNSURE
from tactile.markers.tracking import follow, reference_of

PITCH_PX, RADIUS_PX, SHAPE = 30.0, 5.0, (240, 320)
STEPS = (0.0, 0.02, 1.0, 1.02, 1.05, 1.05)
"""Of the whole motion, in six frames."""
STEEPEST = 0.5
"""Pitches by which neighbours move apart in what is called steep."""


def drawn(markers_px: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Dark discs with an edge of one pixel on a gel lit unevenly, with noise of two grey levels."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    away = cKDTree(markers_px).query(np.stack([columns.ravel(), rows.ravel()], axis=1))[0].reshape(SHAPE)
    cover = np.clip(RADIUS_PX + 0.5 - away, 0.0, 1.0)
    light = 110.0 * (1.0 + 0.3 * (columns / SHAPE[1] - 0.5)) * (1.0 - 0.7 * cover)
    tinted = light[..., None] * [1.0, 0.9, 0.8] + rng.normal(scale=2.0, size=(*SHAPE, 3))
    return np.clip(np.rint(tinted), 0, 255).astype(np.uint8)


def one(seed: int) -> dict[str, float]:
    """The jump of a seed: pitches it carries, steepness, share of markers a pitch off, least certainty."""
    rng = np.random.default_rng(seed)
    columns, rows = np.meshgrid(np.arange(-4, 16) * PITCH_PX, np.arange(-4, 13) * PITCH_PX)
    angle = rng.uniform(-0.03, 0.03)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    grid = np.stack([columns.ravel(), rows.ravel()], axis=1) @ turn.T + rng.uniform(0, PITCH_PX, 2)
    away = grid - rng.uniform([20, 20], [300, 220])
    width, pitches = rng.uniform(35, 110), rng.uniform(0.3, 1.5)
    angle, spread = rng.uniform(0, 2 * np.pi), rng.uniform(-0.12, 0.3)
    fade = np.exp(-(away**2).sum(axis=1, keepdims=True) / 2 / width**2)
    move = PITCH_PX * fade * (pitches * np.array([np.cos(angle), np.sin(angle)]) + spread * away / width)
    pictures = [drawn(grid + step * move, rng) for step in STEPS]
    if rng.random() < 0.5:
        pictures[2] = cv2.GaussianBlur(pictures[2], (0, 0), 2.5)
    reference = reference_of(pictures[0], source="drawn")
    apart, which = cKDTree(grid).query(reference.lattice.rest_px)
    found = list(follow(reference, pictures))
    off = [
        np.linalg.norm(frame.position_px - (grid + step * move)[which], axis=1)[apart < 2] > PITCH_PX / 2
        for frame, step in zip(found, STEPS, strict=True)
    ]
    return {
        "pitches": pitches,
        "steep": 0.6 * pitches * PITCH_PX / width,
        "off": float(np.mean(off, axis=1).max()),
        "certainty": min(frame.certainty for frame in found),
    }


def main() -> None:
    """Shares by the size of the jump."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    found = [one(seed) for seed in range(given.first, given.last)]
    print("pitches    gel     jumps  all off  some off  said  off, unsaid")
    for low, high in ((0.3, 0.6), (0.6, 0.9), (0.9, 1.2), (1.2, 1.5)):
        for steep in (False, True):
            rows = [r for r in found if low <= r["pitches"] < high and (r["steep"] >= STEEPEST) == steep]
            whole = [r for r in rows if r["off"] > 0.5]
            some = [r for r in rows if 0.03 < r["off"] <= 0.5]
            said = [r for r in rows if r["certainty"] < UNSURE]
            unsaid = [r for r in whole if r["certainty"] >= UNSURE]
            print(
                f"{low} to {high} {'steep' if steep else 'mild ':6s} {len(rows):6d} {len(whole):8d} "
                f"{len(some):9d} {len(said):5d} {len(unsaid):12d}"
            )


if __name__ == "__main__":
    main()

"""Closed contours by dynamic programming: the best one is found, whatever single odds inside it say."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from recon.silhouettes.star_cut import best_rings, star_cuts

SIDE = 220
CENTRE = np.array([108.0, 112.0])


def disc(radius_px: float) -> Bool[np.ndarray, "h w"]:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    return np.asarray(np.hypot(columns - CENTRE[0], rows - CENTRE[1]) < radius_px)


def painted(mask: Bool[np.ndarray, "h w"], rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    colours = np.where(mask[..., None], [30.0, 25.0, 15.0], [80.0, 0.0, 6.0]) + rng.normal(
        0, 1.5, (SIDE, SIDE, 3)
    )
    return cv2.GaussianBlur(colours.astype(np.float32), (0, 0), 0.8)


def overlap(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_a_highlight_that_looks_like_ground_takes_no_bite_out_of_the_fruit():
    rng = np.random.default_rng(0)
    truth = disc(70)
    log_odds = np.where(truth, 3.0, -3.0).astype(np.float32)
    log_odds[105:125, 80:98] = -3.0
    (cut,) = star_cuts([log_odds], [painted(truth, rng)], [CENTRE + np.array([5.0, -4.0])])
    assert overlap(cut, truth) > 0.975


def test_the_path_is_the_best_of_all_closed_ones():
    rng = np.random.default_rng(3)
    gain = rng.normal(0, 2, (4, 6, 4)).astype(np.float32)
    paths = best_rings(gain, bend=0.7, steepest=1)
    every = np.stack(np.meshgrid(*[np.arange(4)] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    steps = np.abs(np.diff(every, axis=1, append=every[:, :1]))
    closed = every[(steps[:, :-1] <= 1).all(1) & (steps[:, -1] == 0)]
    for ring, path in zip(gain, paths, strict=True):
        assert np.abs(np.diff(path)).max() <= 1
        assert path[0] == path[-1]
        starts = closed[closed[:, 0] == path[0]]
        worth = ring[np.arange(6), starts].sum(1) - 0.7 * np.abs(np.diff(starts, axis=1)).sum(1)
        path_worth = ring[np.arange(6), path].sum() - 0.7 * np.abs(np.diff(path)).sum()
        assert path_worth >= worth.max() - 1e-4

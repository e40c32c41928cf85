"""How much of a contact sticks: the share of its markers that move with the body they touch."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

BEYOND_NOISE = 4.0
"""Standard deviations of a marker's noise: one in 15,000 by chance."""
LAGS_BEHIND = 0.3
"""A marker slips when it misses the body's motion by more than this share of it (and than noise)."""
FEWEST = 4
"""Markers from which the motion of a body (three numbers) is taken: two tell it, two more judge it."""
SAMPLES = 24
"""Of RANSAC: where half of the markers stick, one draw of four in 16 is clean, and 24 miss it with
probability 21 %; the rounds after mend it."""
ROUNDS = 2
"""Of the body's motion and the markers that follow it. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class Stick:
    """Per frame: the share of the touching markers that stick (0 where none touch), and which do."""

    ratio: Float[np.ndarray, " t"]
    sticks: Bool[np.ndarray, "t n"]


def stick_ratio(
    position: Float[np.ndarray, "t n d"], touching: Bool[np.ndarray, "t n"], *, noise: float, lag: int
) -> Stick:
    """Which touching markers moved, over the last `lag` frames, as the rigid body that most of them follow.

    Positions may be in the plane or in space, px or mm; `noise` is one coordinate's standard deviation in one
    frame. The body's motion is fitted to the markers that touch throughout and reweighted until outliers
    carry none of it (Cauchy's weights). What the gel cannot see it does not tell: a fruit that slides past
    all markers at the same time looks like one at rest. A marker that has touched for less than `lag` frames
    counts as sticking; a frame where fewer than four can be compared has all its touching markers stick.
    """
    frames = len(touching)
    sticks = touching.copy()
    seen = np.isfinite(position).all(axis=2)
    for t in range(lag, frames):
        both = touching[t] & touching[t - lag] & seen[t] & seen[t - lag]
        if both.sum() < FEWEST:
            continue
        before, after = position[t - lag, both], position[t, both]
        carried = _carried(before, after, noise=noise)
        follows = _within(before, after, carried, BEYOND_NOISE * noise * np.sqrt(2.0))
        sticks[t, np.flatnonzero(both)[~follows]] = False
    touched = touching.sum(axis=1)
    return Stick(ratio=sticks.sum(axis=1) / np.maximum(touched, 1), sticks=sticks)


def _carried(
    before: Float[np.ndarray, "n d"], after: Float[np.ndarray, "n d"], *, noise: float
) -> Float[np.ndarray, "n d"]:
    """`before` under the rigid motion that most markers follow: of a few markers' the one most agree
    with, fitted again to those.
    """
    rng = np.random.default_rng(len(before))
    least = BEYOND_NOISE * noise * np.sqrt(2.0)
    best, votes = before, -1
    for _ in range(SAMPLES):
        some = rng.choice(len(before), size=FEWEST, replace=False)
        carried = _rigid(before[some], after[some], before)
        within = _within(before, after, carried, least)
        for _ in range(ROUNDS):
            if within.sum() < FEWEST:
                break
            carried = _rigid(before[within], after[within], before)
            within = _within(before, after, carried, least)
        if within.sum() > votes:
            best, votes = carried, int(within.sum())
    return best


def _within(
    before: Float[np.ndarray, "n d"],
    after: Float[np.ndarray, "n d"],
    carried: Float[np.ndarray, "n d"],
    least: float,
) -> Bool[np.ndarray, " n"]:
    """Which markers arrive where the body's motion carries them."""
    moved = float(np.median(np.linalg.norm(carried - before, axis=1)))
    return np.asarray(np.linalg.norm(after - carried, axis=1) <= max(least, LAGS_BEHIND * moved))


def _rigid(
    before: Float[np.ndarray, "m d"], after: Float[np.ndarray, "m d"], points: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "n d"]:
    """`points` under the rotation and shift that take `before` to `after` best (Kabsch 1976)."""
    a, b = before.mean(axis=0), after.mean(axis=0)
    u, _, vt = np.linalg.svd((before - a).T @ (after - b))
    flip = np.ones(before.shape[1])
    flip[-1] = 1.0 if np.linalg.det(u @ vt) > 0 else -1.0
    return np.asarray(b + (points - a) @ (u * flip) @ vt)

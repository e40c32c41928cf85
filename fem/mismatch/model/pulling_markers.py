"""Markers at which the gel pulls at the skin: it sticks, and has not let go yet.

A gel that bulges beside the contact pulls too, and what drifts does so at markers that never touch: the
median of these is taken out, and a pull before the first touch is told from one after it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.grasp_history import PadHistory

PULLS = 6.0
"""Standard deviations of a marker's normal force beyond which it pulls: 1e-9 in Gaussian noise, of some 1e5
numbers a recording. In 16 labelled cases without it, four recordings each, no marker had one after its touch;
with a gel that sticks 150 of 400 do (`benchmarks/mismatch_bank.py`, cases of adhesion)."""
FEWEST_APART = 4
"""Markers that never touch, at least: their median tells a drift to 0.6 of a marker's noise. Where there are
fewer a pull cannot be told from a drift, and none is seen."""


@dataclass(frozen=True, kw_only=True)
class Pulling:
    """Which markers pull in which frame, before (`earlier`) or after they have touched (`later`); the normal
    force (N) and stretch (mm) of all, negative and positive where the gel is drawn out.
    """

    earlier: Bool[np.ndarray, "t n"]
    later: Bool[np.ndarray, "t n"]
    normal_N: Float[np.ndarray, "t n"]
    stretch_mm: Float[np.ndarray, "t n"]


def pulling(history: PadHistory, normal: Float[np.ndarray, "t 3"]) -> Pulling:
    """Of one pad of one recording; `normal`: the pad's, out of its face, in every frame."""
    touched = history.episode >= 0
    ever = np.asarray(touched.any(axis=0))
    force = _near_those_apart(np.einsum("tnx,tx->tn", history.force_N, normal), ever)
    stretch = _near_those_apart(np.einsum("tnx,tx->tn", history.gel_displacement_mm, normal), ever)
    pulls = (force < -PULLS * history.force_sd_N) & (stretch > 0) & ever
    since = np.maximum.accumulate(touched, axis=0)
    return Pulling(earlier=pulls & ~since, later=pulls & since & ~touched, normal_N=force, stretch_mm=stretch)


def pull_N2(
    history: PadHistory, normal: Float[np.ndarray, "t 3"], frames: Bool[np.ndarray, " t"]
) -> Float[np.ndarray, " f"]:
    """Sum of squares of what markers pull with after their touch, in the frames given."""
    found = pulling(history, normal)
    squares: Float[np.ndarray, " t"] = np.where(found.later, found.normal_N**2, 0.0).sum(axis=1)
    return squares[frames]


def _near_those_apart(
    values: Float[np.ndarray, "t n"], ever: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "t n"]:
    """Less what markers that never touch show in the same frame; nothing where there are too few."""
    apart = ~ever
    if apart.sum() < FEWEST_APART:
        return np.zeros_like(values)
    return np.asarray(values - np.median(values[:, apart], axis=1, keepdims=True))

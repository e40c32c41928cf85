"""Markers at which the gel pulls at the skin, before and after they have touched it.

What drifts seems to pull at markers that never touch too: their median is taken out. A gel that bulges beside
the contact pulls before the first touch as well as after it; one that sticks only after it.

    ln evidence = a ln(a / m) + b ln(b / m),      m = (a + b) / 2,      a > b

a, b: markers that pull at some time after and before their first touch (likelihood ratio of two Poisson
counts, one-sided).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.grasp_history import PadHistory
from fem.mismatch.mismatch_case import GraspCase

PULLS = 6.0
"""Standard deviations of a marker's normal force beyond which it pulls: 1e-9 in Gaussian noise, of some 1e5
numbers a recording. In 16 labelled cases without it, four recordings each, no marker had one after its touch;
with a gel that sticks 150 of 400 do (`benchmarks/mismatch_bank.py`, cases of adhesion)."""
LEAST_EVIDENCE = 20.0
"""ln evidence, of all recordings together: 29 pulling markers, where none does before its touch. The sound
cases of `benchmarks/mismatch_bank.py` have none."""
FEWEST_APART = 4
"""Markers that never touch, at least: their median tells a drift to 0.6 of a marker's noise. Where there are
fewer a pull cannot be told from a drift, and none is seen."""


@dataclass(frozen=True, kw_only=True)
class Pulling:
    """Which markers pull in which frame, before (`earlier`) or after they have touched (`later`). Of all: the
    normal force (N), negative where the gel pulls, and the stretch (mm), positive where it is drawn out.
    """

    earlier: Bool[np.ndarray, "t n"]
    later: Bool[np.ndarray, "t n"]
    normal_N: Float[np.ndarray, "t n"]
    stretch_mm: Float[np.ndarray, "t n"]


def pulling(history: PadHistory, normal: Float[np.ndarray, "t 3"]) -> Pulling:
    """Of one pad of one recording; `normal`: the pad's, out of its face, in every frame."""
    touched = history.episode >= 0
    ever = np.asarray(touched.any(axis=0))
    force = _less_untouched_median(np.einsum("tnx,tx->tn", history.force_N, normal), ever)
    stretch = _less_untouched_median(np.einsum("tnx,tx->tn", history.gel_displacement_mm, normal), ever)
    pulls = (force < -PULLS * history.force_sd_N) & (stretch > 0) & ever
    since = np.maximum.accumulate(touched, axis=0)
    return Pulling(earlier=pulls & ~since, later=pulls & since & ~touched, normal_N=force, stretch_mm=stretch)


def stick_evidence(after: int, before: int) -> float:
    """ln evidence that a gel sticks, of the module's docstring."""
    if after <= before:
        return 0.0
    mean = (after + before) / 2
    return float(sum(n * np.log(n / mean) for n in (after, before) if n))


@dataclass(frozen=True, kw_only=True)
class Pull:
    """Markers that pull `after` and `before` their first touch, by how far they are drawn out (mm) and the
    noise of that.
    """

    after: int
    before: int
    stretch_mm: Float[np.ndarray, " k"]
    noise_mm: float

    @property
    def evidence(self) -> float:
        """ln evidence that the gel sticks, of the module's docstring."""
        return stick_evidence(self.after, self.before)

    @property
    def reach_mm(self) -> tuple[float, float]:
        """The reach and its standard deviation."""
        second, largest = np.sort(self.stretch_mm)[-2:]
        return float(2 * largest - second), float(np.hypot(largest - second, self.noise_mm))


def pads_with_normals(recording: GraspCase) -> list[tuple[PadHistory, Float[np.ndarray, "t 3"]]]:
    """Each pad of a recording with its normal, out of its face, in every frame."""
    return [
        (history, motion.pose[:, :3, 2])
        for history, motion in zip(recording.history.pads, recording.pads, strict=True)
    ]


def pulled(history: PadHistory, normal: Float[np.ndarray, "t 3"]) -> Pull:
    """One pad of one recording, all its frames; `normal` as in `pulling`."""
    pulls = pulling(history, normal)
    return Pull(
        after=int(pulls.later.any(axis=0).sum()),
        before=int(pulls.earlier.any(axis=0).sum()),
        stretch_mm=pulls.stretch_mm[pulls.later],
        noise_mm=history.displacement_sd_mm,
    )


def pull_N(recording: GraspCase) -> Float[np.ndarray, "t n 3"]:
    """What the gel pulls with at each marker, of all pads, after its touch."""
    pads = pads_with_normals(recording)
    sizes = [np.where(pulls.later, pulls.normal_N, 0.0) for pulls in (pulling(*pad) for pad in pads)]
    return np.concatenate(
        [size_N[..., None] * normal[:, None] for size_N, (_, normal) in zip(sizes, pads, strict=True)], axis=1
    )


def _less_untouched_median(
    values: Float[np.ndarray, "t n"], ever: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "t n"]:
    """Less what markers that never touch show in the same frame; nothing where there are too few."""
    apart = ~ever
    if apart.sum() < FEWEST_APART:
        return np.zeros_like(values)
    return np.asarray(values - np.median(values[:, apart], axis=1, keepdims=True))

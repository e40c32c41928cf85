"""Markers at which the gel pulls at the skin, before and after they have touched it.

A drift seems to pull also at markers that never touch; their median is subtracted. A gel that bulges beside
the contact pulls before and after the first touch; a gel that sticks pulls only after it.

    ln evidence = a ln(a / m) + b ln(b / m),      m = (a + b) / 2,      a > b

a, b: markers that pull at some time after and before their first touch (likelihood ratio of two Poisson
counts, one-sided).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.grasp_history import PadHistory
from fem.mismatch.mismatch_case import GraspCase

PULLS = 6.0
"""Standard deviations of a marker's normal force beyond which it pulls: probability 1e-9 in Gaussian noise,
for some 1e5 numbers a recording. In 16 labelled cases without adhesion, four recordings each, no marker
pulled after its touch; with a gel that sticks 150 of 400 do (`benchmarks/mismatch_bank.py`, adhesion)."""
LEAST_EVIDENCE = 20.0
"""Log evidence of all recordings above which gels stick: 29 pulling markers, if none pulls before its touch.
Cases of `benchmarks/mismatch_bank.py` without mismatch have none."""
FEWEST_APART = 4
"""Fewest markers that never touch: their median measures a drift to 0.6 of a marker's noise. With fewer, a
pull cannot be separated from a drift, and none is reported."""


@dataclass(frozen=True, kw_only=True)
class PullingPad:
    """Markers of a pad that pull in each frame, before (`earlier`) or after (`later`) their first touch. For
    all markers: normal force (N), negative where the gel pulls; stretch (mm), positive where the gel is drawn
    out; the stretch's noise. `normal`: of the pad, out of its face, in every frame.
    """

    earlier: Bool[np.ndarray, "t n"]
    later: Bool[np.ndarray, "t n"]
    normal_N: Float[np.ndarray, "t n"]
    stretch_mm: Float[np.ndarray, "t n"]
    noise_mm: float
    normal: Float[np.ndarray, "t 3"]

    @classmethod
    def of(cls, history: PadHistory, normal: Float[np.ndarray, "t 3"]) -> "PullingPad":
        """One pad of one recording."""
        touched = history.episode >= 0
        ever = np.asarray(touched.any(axis=0))
        force, stretch = (
            _less_untouched_median(np.einsum("tnx,tx->tn", vectors, normal), ever)
            for vectors in (history.force_N, history.gel_displacement_mm)
        )
        pulls = (force < -PULLS * history.force_sd_N) & (stretch > 0) & ever
        since = np.maximum.accumulate(touched, axis=0)
        return cls(
            earlier=pulls & ~since,
            later=pulls & since & ~touched,
            normal_N=force,
            stretch_mm=stretch,
            noise_mm=history.displacement_sd_mm,
            normal=normal,
        )


def pulling_pads(recording: GraspCase) -> list[PullingPad]:
    """Each pad of a recording."""
    pads = zip(recording.history.pads, recording.pads, strict=True)
    return [PullingPad.of(history, motion.pose[:, :3, 2]) for history, motion in pads]


def pull_N(recording: GraspCase) -> Float[np.ndarray, "t n 3"]:
    """Pulling force at each marker of all pads after its first touch, N."""
    pads = pulling_pads(recording)
    return np.concatenate(
        [np.where(pad.later, pad.normal_N, 0.0)[..., None] * pad.normal[:, None] for pad in pads], axis=1
    )


@dataclass(frozen=True, kw_only=True)
class Pull:
    """Numbers of markers that pull `after` and `before` their first touch, the gel's stretch at the former
    (mm) and its noise.
    """

    after: int
    before: int
    stretch_mm: Float[np.ndarray, " k"]
    noise_mm: float

    @classmethod
    def of(cls, recordings: Sequence[GraspCase]) -> "Pull":
        """From all pads of the recordings."""
        pads = [pad for recording in recordings for pad in pulling_pads(recording)]
        return cls(
            after=sum(int(pad.later.any(axis=0).sum()) for pad in pads),
            before=sum(int(pad.earlier.any(axis=0).sum()) for pad in pads),
            stretch_mm=np.concatenate([pad.stretch_mm[pad.later] for pad in pads]),
            noise_mm=max(pad.noise_mm for pad in pads),
        )

    @property
    def evidence(self) -> float:
        """Log evidence that the gel sticks (module docstring)."""
        if self.after <= self.before:
            return 0.0
        mean = (self.after + self.before) / 2
        return float(sum(n * np.log(n / mean) for n in (self.after, self.before) if n))

    @property
    def reach_mm(self) -> tuple[float, float]:
        """The reach and its standard deviation."""
        second, largest = np.sort(self.stretch_mm)[-2:]
        return float(2 * largest - second), float(np.hypot(largest - second, self.noise_mm))


def _less_untouched_median(
    values: Float[np.ndarray, "t n"], ever: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "t n"]:
    """Values less each frame's median over markers that never touch; zero if these are too few."""
    apart = ~ever
    if apart.sum() < FEWEST_APART:
        return np.zeros_like(values)
    return np.asarray(values - np.median(values[:, apart], axis=1, keepdims=True))

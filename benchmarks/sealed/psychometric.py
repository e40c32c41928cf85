"""Psychometric curves: share of cases detected or named against the logarithm of a stimulus.

    P(x) = 1 / (1 + exp(-k (ln x - m))),      half of the cases at exp(m)

by greatest posterior probability (Treutwein 1995, Vision Research 35, 2503), with weak priors that keep the
fit finite where all or none of the cases are named: ln k ~ N(ln 2, 1), m ~ N(middle of the cases, 2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

STEEPNESS, STEEPNESS_SD, MIDDLE_SD = 2.0, 1.0, 2.0
"""Priors: a steepness of 2 takes the share from .1 to .9 over a factor of nine; the spread of its logarithm;
and how far the half may lie from the middle of the stimuli, in units of ln."""
FEWEST = 3
"""Cases, at least, of which a curve is fitted; with fewer there is nothing to fit."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """`half`: the stimulus at which half is seen; `steepness`: k; `seen`: whether any and not all were."""

    half: float
    steepness: float
    seen: int
    total: int

    @property
    def bracketed(self) -> bool:
        """Whether some are seen and some are not: else the half is where the prior and the cases leave it."""
        return 0 < self.seen < self.total

    @property
    def half_in_words(self) -> str:
        """The half, in brackets unless it is bracketed by cases."""
        return f"{self.half:.3g}" if self.bracketed else f"({self.half:.3g})"


def fitted_curve(stimuli: Sequence[float], seen: Sequence[bool]) -> Curve | None:
    """The curve of these cases; None for fewer than FEWEST with a stimulus above zero."""
    x, y = np.array(stimuli, dtype=float), np.array(seen, dtype=float)
    usable = np.isfinite(x) & (x > 0)
    x, y = np.log(x[usable]), y[usable]
    if len(x) < FEWEST:
        return None
    middle = float((x.min() + x.max()) / 2)

    def loss(theta: np.ndarray) -> float:
        z = np.exp(theta[1]) * (x - theta[0])
        likelihood = float((np.logaddexp(0, z) - y * z).sum())
        prior = ((theta[0] - middle) / MIDDLE_SD) ** 2 + ((theta[1] - np.log(STEEPNESS)) / STEEPNESS_SD) ** 2
        return likelihood + float(prior) / 2

    best = min(
        (
            minimize(loss, [start, np.log(STEEPNESS)], method="Nelder-Mead")
            for start in (x.min(), middle, x.max())
        ),
        key=lambda optimum: float(optimum.fun),
    )
    return Curve(
        half=float(np.exp(best.x[0])), steepness=float(np.exp(best.x[1])), seen=int(y.sum()), total=len(y)
    )

"""Softening of a lot: exponential decay of its mean modulus over days, and the day at which it meets a limit.

    ln E_ij = a - k t_i + d_i + e_ij        fruit j on day t_i

k is the softening rate per day. d_i (standard deviation tau) is the common deviation of one day's fruit: from
another part of the lot, another temperature, or that day's gripper. e_ij is the deviation of a single fruit.
The model is a random-effects regression: for each tau, a and k are normal with flat priors. Few days hardly
determine tau. It has a half-normal prior (Gelman, Bayesian Analysis 1, 2006, 515), and drupe averages over
it. All intervals are quantiles of this mixture. The lot reaches the limit L by day t with the probability
that a - k t < ln L. For a single tau this is Fieller's interval (J. R. Stat. Soc. B 16, 1954, 175).

Exponential decay describes the first part of softening; it predicts too firm kiwifruit in the middle (Benge
et al., Postharvest Biol. Technol. 19, 2000, 211). Predictions therefore end at FARTHEST observed spans.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

FARTHEST = 2.0
"""Longest prediction beyond the last day, over the observed span of days. Set by hand."""
COVERAGE = 0.9
"""Probability of all intervals in this package."""
DAY_SD = 0.1
"""Scale of tau's prior (ln E): samples and sensors of two days differ by 5 to 10 %. Set by hand."""
_TAU = np.linspace(0.0, 4.0 * DAY_SD, 41)
"""Values of tau in the average; the prior's probability beyond them is 6e-5."""
_BISECTIONS = 60
"""Halvings of a bracket: they reduce 24 standard deviations to 2e-17 of one."""


@dataclass(frozen=True, kw_only=True)
class Softening:
    """The fitted law: a, k (1/day) and their covariance for each tau, with its weight.

    `first`, `last`: first and last day of measurement; `days`: number of days with measurements; `fruit_sd`:
    standard deviation of ln E of single fruit; `day_sd`: mean of tau.
    """

    first: float
    last: float
    days: int
    fruit_sd: float
    day_sd: float
    weights: Float[np.ndarray, " m"]
    a: Float[np.ndarray, " m"]
    k: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m 2 2"]

    def rate(self, share: float = 0.5) -> float:
        """Quantile of k, 1/day."""
        sd = np.sqrt(self.covariance[:, 1, 1])
        return float(_quantile(share, self.k[None], sd[None], self.weights)[0])

    @property
    def softens(self) -> bool:
        """Whether the 90 % interval of k is above zero."""
        return self.rate(0.5 - COVERAGE / 2) > 0

    @property
    def farthest_day(self) -> float:
        """The last day of predictions."""
        return self.last + FARTHEST * (self.last - self.first)

    def ln_E(self, day: Float[np.ndarray, " t"], share: float = 0.5) -> Float[np.ndarray, " t"]:
        """Quantile of the lot's mean ln E on these days."""
        return _quantile(share, *self.on(day), self.weights)

    def on(self, day: Float[np.ndarray, " t"]) -> tuple[Float[np.ndarray, "t m"], Float[np.ndarray, "t m"]]:
        """The lot's mean ln E on these days for each tau, and its standard deviation."""
        t = day[:, None]
        of_a, of_both, of_k = self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1]
        return self.a - t * self.k, np.sqrt(np.maximum(of_a + t * (t * of_k - 2 * of_both), 0.0))


def softening_of(E_MPa: Mapping[float, Sequence[float]], *, single_sd: float) -> Softening | None:
    """The law for E of fruit by day (days since any start); None for fewer than two days.

    `single_sd`: standard deviation of one fruit's ln E if no day has two fruit.
    """
    days = sorted(day for day, fruit in E_MPa.items() if fruit)
    if len(days) < 2:
        return None
    logs = [np.log(np.asarray(E_MPa[day], dtype=float)) for day in days]
    fruit_sd = pooled_sd(logs) or single_sd
    t, means = np.array(days), np.array([of_day.mean() for of_day in logs])
    variance = fruit_sd**2 / np.array([len(of_day) for of_day in logs])
    coefficients, covariance, ln_likelihood = _weighted(t, means, variance + _TAU[:, None] ** 2)
    ln_weights = ln_likelihood - 0.5 * (_TAU / DAY_SD) ** 2
    weights = np.exp(ln_weights - ln_weights.max())
    weights /= weights.sum()
    return Softening(
        first=days[0],
        last=days[-1],
        days=len(days),
        fruit_sd=fruit_sd,
        day_sd=float(weights @ _TAU),
        weights=weights,
        a=coefficients[:, 0],
        k=coefficients[:, 1],
        covariance=covariance,
    )


def reached(
    law: Softening, limit_MPa: float, *, share: float = 0.5
) -> tuple[float | None, float | None, float | None]:
    """The days by which a share of the fruit falls to a limit with a probability of 5, 50 and 95 %; None if
    that is beyond the last predicted day, or never. The mean reaches the limit with half of the fruit. For
    another share, ln E shifts by the normal quantile of single fruit, ndtri(share) fruit_sd.
    """
    days = np.linspace(law.first, law.farthest_day, 2001)
    mean, sd = law.on(days)
    fruit = mean + ndtri(share) * law.fruit_sd
    below = np.maximum.accumulate(ndtr((math.log(limit_MPa) - fruit) / sd) @ law.weights)

    def by(chance: float) -> float | None:
        return float(np.interp(chance, below, days)) if below[-1] >= chance else None

    return by(0.5 - COVERAGE / 2), by(0.5), by(0.5 + COVERAGE / 2)


def pooled_sd(logs: Sequence[Float[np.ndarray, " _n"]]) -> float:
    """Pooled standard deviation within groups; 0 if no group has two values."""
    degrees = sum(len(of_day) - 1 for of_day in logs)
    squares = sum(float(((of_day - of_day.mean()) ** 2).sum()) for of_day in logs)
    return math.sqrt(squares / degrees) if degrees else 0.0


def _weighted(
    t: Float[np.ndarray, " d"], mean: Float[np.ndarray, " d"], variance: Float[np.ndarray, "m d"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2 2"], Float[np.ndarray, " m"]]:
    """a and k, their covariance, and the log marginal likelihood with flat priors of both, for each tau."""
    design = np.stack([np.ones_like(t), -t], axis=1)
    precision = design.T @ (design / variance[:, :, None])
    covariance = np.linalg.inv(precision)
    coefficients = np.einsum("mij,mj->mi", covariance, (mean / variance) @ design)
    left = mean - coefficients @ design.T
    ln_likelihood = -0.5 * (left**2 / variance + np.log(variance)).sum(axis=1)
    return coefficients, covariance, ln_likelihood - 0.5 * np.linalg.slogdet(precision)[1]


def _quantile(
    share: float,
    mean: Float[np.ndarray, "t m"],
    sd: Float[np.ndarray, "t m"],
    weights: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " t"]:
    """Quantile of mixtures of normals, by bisection."""
    low, high = (mean - 12 * sd).min(axis=1), (mean + 12 * sd).max(axis=1)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        under = ndtr((middle[:, None] - mean) / sd) @ weights < share
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return np.asarray((low + high) / 2)


def change_per_day(rate: float) -> float:
    """Change of E in a day, per cent, at a rate of ln E (1/day).

    >>> round(change_per_day(-0.10536), 1)
    -10.0
    """
    return 100 * math.expm1(rate)

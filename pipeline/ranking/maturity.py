"""From moduli with error bars to maturity classes and a ranking with probabilities."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from pipeline.batch.settings import GradingClass
from reports.entries import ShoreCorrelation

EXACT_UP_TO = 7
"""Most fruit whose orders (5040) are few enough to count them all."""
DRAWS = 4000
"""Joint draws from which rank probabilities are counted."""


@dataclass(frozen=True, kw_only=True)
class Rank:
    """A graded fruit's place: rank (1 = softest) and how sure it is."""

    rank: int
    rank_probability: float
    rank_low: int
    rank_high: int
    p_softer_than_next: float | None
    maturity: str | None
    maturity_probability: float | None
    class_probabilities: tuple[float, ...] = ()
    """Probability of each class of the batch, softest first; they add up to 1."""


def standings(
    E_MPa: Float[np.ndarray, " n"],
    E_sd_MPa: Float[np.ndarray, " n"],
    common_sd_MPa: Float[np.ndarray, " n"],
    *,
    scale_sd_MPa: Float[np.ndarray, " n"] | float = 0.0,
    classes: Sequence[GradingClass],
    rng: np.random.Generator,
) -> list[Rank]:
    """Each fruit's standing, in the order given.

    `common_sd_MPa` is the part of `E_sd_MPa` that all fruit share (Poisson's ratio, say). It counts for the
    class, which has fixed limits, and not for the order. So does `scale_sd_MPa`, which `E_sd_MPa` excludes.

    The modulus is positive with an error that scales with it. So it is assumed lognormal, independent between
    fruits: `log E ~ N(log E, (sd/E)^2)`. Rank probabilities come from DRAWS joint draws; `rank_low` and
    `rank_high` hold the central 90 %. The probability of being softer than the next fruit in the ranking is
    exact: `Phi((log E_next - log E) / sqrt(s^2 + s_next^2))`.
    """
    mean, whole = np.log(E_MPa), np.hypot(E_sd_MPa, scale_sd_MPa) / E_MPa
    spread = np.sqrt(np.maximum(E_sd_MPa**2 - common_sd_MPa**2, 0)) / E_MPa
    order = np.lexsort((np.arange(len(mean)), mean))
    rank = np.empty(len(mean), dtype=int)
    rank[order] = np.arange(1, len(mean) + 1)
    drawn = mean + spread * rng.standard_normal((DRAWS, len(mean)))
    ranks = drawn.argsort(axis=1).argsort(axis=1) + 1
    low, high = np.percentile(ranks, [5, 95], axis=0, method="nearest").astype(int)
    result = []
    for i in range(len(mean)):
        softer = None
        if rank[i] < len(mean):
            j = order[rank[i]]
            softer = _phi(mean[j] - mean[i], math.hypot(spread[i], spread[j]))
        name, probability = maturity(mean[i], whole[i], classes)
        shares = class_probabilities(mean[i], whole[i], classes)
        result.append(
            Rank(
                rank=int(rank[i]),
                rank_probability=float((ranks[:, i] == rank[i]).mean()),
                rank_low=int(low[i]),
                rank_high=int(high[i]),
                p_softer_than_next=softer,
                maturity=name,
                maturity_probability=probability,
                class_probabilities=shares,
            )
        )
    return result


def maturity(log_E: float, log_sd: float, classes: Sequence[GradingClass]) -> tuple[str | None, float | None]:
    """The class that contains E, and the probability that it contains the true modulus; None without
    classes."""
    shares = class_probabilities(log_E, log_sd, classes)
    for grade, share in zip(classes, shares, strict=True):
        if log_E <= _log_limit(grade):
            return grade.name, share
    return None, None


def class_probabilities(log_E: float, log_sd: float, classes: Sequence[GradingClass]) -> tuple[float, ...]:
    """The probability of each class, softest first: with upper limits b_k,

        P_k = Phi((log b_k - log E) / s) - Phi((log b_(k-1) - log E) / s),      s = sd/E

    which is the probability that the true modulus lies between the class's limits, with a lognormal error.
    """
    up_to = [0.0, *(_phi(_log_limit(grade) - log_E, log_sd) for grade in classes)]
    return tuple(above - below for below, above in itertools.pairwise(up_to))


def _log_limit(grade: GradingClass) -> float:
    """log of the class's highest modulus; infinity if it has none."""
    return math.inf if grade.E_max_MPa is None else math.log(grade.E_max_MPa)


def agreement(E_MPa: Float[np.ndarray, " n"], reference: Float[np.ndarray, " n"]) -> ShoreCorrelation | None:
    """Spearman and Pearson correlation of log E with a reference; None under three fruits or no spread.

    `p` is two-sided for the rank correlation: from all orders up to seven fruit, by Student's t beyond.
    """
    if len(E_MPa) < 3 or np.ptp(reference) == 0 or np.ptp(E_MPa) == 0:
        return None
    from scipy.stats import pearsonr, permutation_test, spearmanr  # slow to import, and few batches need it

    rank = spearmanr(E_MPa, reference)
    p = rank.pvalue
    if len(E_MPa) <= EXACT_UP_TO:
        test = permutation_test(
            (E_MPa,),
            lambda order: spearmanr(order, reference).statistic,
            permutation_type="pairings",
            n_resamples=math.factorial(len(E_MPa)),
        )
        p = test.pvalue
    return ShoreCorrelation(
        n=len(E_MPa),
        spearman=float(rank.statistic),
        pearson=float(pearsonr(np.log(E_MPa), reference).statistic),
        p=float(p),
    )


def _phi(difference: float, sd: float) -> float:
    """P(X < difference) for X ~ N(0, sd^2); a step where sd is zero."""
    if sd == 0:
        return float(difference > 0) if difference else 0.5
    return float(ndtr(difference / sd))

"""The posterior of all explanations, and the test against no mismatch: here alone the finder decides.

Explanations are none, every effect, pairs of effects, and "unknown": physics outside the catalogue. Each has
a prior probability, a log Bayes factor over the plain model (by linear signatures or by a refit, model error
included) and a misfit x, the chi-square per number that it leaves. Without a mismatch x scatters as MISFIT
chi-square(FREEDOM) / FREEDOM. Unknown physics resembles one of the explanations and leaves any misfit up to
MOST_MISFIT times the usual (a uniform density of ln x). Log Bayes factors are divided by TEMPERATURE.

The verdict is the smallest set of explanations that holds CREDIBLE of the probability.

The p-value needs no bank of recordings. Without a mismatch the products b of the signatures with the data are
Gaussian with covariance N (GramMatrix.beside), so the distribution of a statistic of b follows from draws.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc, gammaln, log_ndtr, logsumexp

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.result import NONE, UNKNOWN

DETECTION_P = 0.05
"""p-value below which there is a mismatch: the usual level."""
CREDIBLE = 0.95
"""Probability of the verdict's set."""
PRIOR: Mapping[str, float] = {NONE: 0.5, "single": 0.35, "pair": 0.1, UNKNOWN: 0.05}
"""Shares of recordings sets before the data; equal for all effects and for all pairs. Set by hand: half of
all fruit have no mismatch, one in twenty has physics outside the catalogue."""
TEMPERATURE = 1.5
"""Divisor of log Bayes factors. Set by hand."""
MISFIT, FREEDOM = 0.037, 26.0
"""Mean and degrees of freedom of the chi-square per number that the plain model leaves of recordings without
mismatch: mean and scatter over `benchmarks/model_error.py`'s fruit."""
MOST_MISFIT = 1000.0
"""Times MISFIT: the greatest misfit by unknown physics. Set by hand: a grasp's signal over its noise."""
DRAWS = 2000
"""Of b without mismatch: p is known to 0.005 at DETECTION_P."""


@dataclass(frozen=True, kw_only=True)
class Weighed:
    """One explanation before its probability. `gain`: log Bayes factor over the plain model. `misfit`:
    chi-square per number.
    """

    name: str
    gain: float
    misfit: float


def log_prior(name: str) -> float:
    """ln of the prior probability of an explanation; effects of a pair are joined by "+".

    >>> round(float(np.exp(log_prior("none"))), 3)
    0.5
    """
    if name == NONE:
        return float(np.log(PRIOR[NONE]))
    count = len(EFFECTS)
    if "+" in name:
        return float(np.log(PRIOR["pair"] / (count * (count - 1) / 2)))
    return float(np.log(PRIOR["single"] / count))


def log_usual(misfit: float) -> float:
    """ln density of ln x without anything missing: a scaled chi-square."""
    half, ratio = FREEDOM / 2, max(misfit / MISFIT, 1e-9)
    return float(half * np.log(half) - gammaln(half) + half * (np.log(ratio) - ratio))


def probabilities(explanations: Sequence[Weighed]) -> tuple[Float[np.ndarray, " h"], float]:
    """Of each of the explanations, and of "unknown"."""
    gain = np.array([one.gain / TEMPERATURE for one in explanations])
    named = np.array([log_prior(one.name) + log_usual(one.misfit) for one in explanations]) + gain
    unlike = float(np.log(PRIOR[UNKNOWN] / len(explanations)) - np.log(np.log(MOST_MISFIT)))
    total = logsumexp([*named, *(gain + unlike)])
    return np.exp(named - total), float(np.exp(logsumexp(gain + unlike) - total))


def credible_set(names: Sequence[str], probability: Sequence[float]) -> tuple[str, ...]:
    """The fewest names that together have CREDIBLE, likeliest first.

    >>> credible_set(["skin", "none", "slip"], [0.9, 0.08, 0.02])
    ('skin', 'none')
    """
    order = np.argsort(-np.asarray(probability), kind="stable")
    total = np.cumsum(np.asarray(probability)[order])
    count = int(np.searchsorted(total, CREDIBLE - 1e-12)) + 1
    return tuple(names[k] for k in order[:count])


def p_values(
    products: GramMatrix,
    nuisances: Sequence[int],
    signatures: Mapping[str, Sequence[Sequence[int]]],
    *,
    misfit: float,
    direct: float,
    rng: np.random.Generator,
) -> tuple[float, dict[str, float]]:
    """The p-value, and that of each statistic.

    "effects": the mean Bayes factor over the catalogue; `signatures`: of every effect its alternatives, each
    the columns of one. "misfit": x of the plain model. "gel": `direct`, the log Bayes factor of what gels
    show by themselves; a Bayes factor above c has a probability of at most 1/c without mismatch (Markov).
    The smallest counts, corrected for their number (Sidak).
    """
    each = {"misfit": float(gammaincc(FREEDOM / 2, FREEDOM / 2 * misfit / MISFIT))}
    sets = {name: [own for own in ways if len(own)] for name, ways in signatures.items()}
    sets = {name: ways for name, ways in sets.items() if ways}
    if sets:
        each["effects"] = _effects_p(products, nuisances, sets, rng)
    if direct > 0:
        each["gel"] = float(np.exp(-direct))
    p = -np.expm1(len(each) * np.log1p(-min(min(each.values()), 1 - 1e-12)))
    return float(p), each


def _effects_p(
    products: GramMatrix,
    nuisances: Sequence[int],
    sets: Mapping[str, Sequence[Sequence[int]]],
    rng: np.random.Generator,
) -> float:
    columns = sorted({j for ways in sets.values() for own in ways for j in own})
    place = {j: k for k, j in enumerate(columns)}
    normal, right = products.beside(nuisances, columns)
    size, axes = np.linalg.eigh(normal)
    root = axes * np.sqrt(np.maximum(size, 0.0))
    drawn = np.vstack([right, rng.standard_normal((DRAWS, len(columns))) @ root.T])
    total = []
    for ways in sets.values():
        known = [
            log_bayes_factor(products, own, normal, drawn, [place[j] for j in own]) - np.log(len(ways))
            for own in ways
        ]
        total.append(logsumexp(known, axis=0))
    statistic = logsumexp(total, axis=0)
    return float((1 + (statistic[1:] >= statistic[0]).sum()) / (DRAWS + 1))


def log_bayes_factor(
    products: GramMatrix,
    columns: Sequence[int],
    normal: Float[np.ndarray, "c c"],
    right: Float[np.ndarray, "d c"],
    at: Sequence[int],
) -> Float[np.ndarray, " d"]:
    """ln of the Bayes factor of these columns over none, for d data; `at`: their places in N and b.

    With a ~ N(0, L^-1): b'(N + L)^-1 b / 2 - ln det(I + L^-1 N) / 2, plus ln 2 Phi(mean / sd) where an amount
    is positive.
    """
    weight = np.array([products.columns[j].sd for j in columns]) ** -2.0
    own = normal[np.ix_(at, at)] + np.diag(weight)
    mine = right[:, list(at)]
    amounts = np.linalg.solve(own, mine.T).T
    log_det = np.linalg.slogdet(own)[1] - np.log(weight).sum()
    found = ((mine * amounts).sum(axis=1) - log_det) / 2
    if len(columns) == 1 and products.columns[columns[0]].positive:
        found = found + np.log(2.0) + log_ndtr(amounts[:, 0] * np.sqrt(own[0, 0]))
    return np.asarray(found)

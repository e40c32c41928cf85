"""The posterior of all explanations, and the test of the null hypothesis; the finder decides only here.

Explanations are none, every effect, pairs of effects, and "unknown": physics outside the catalogue. Each has
a prior probability and a log Bayes factor over the plain model. TEMPERATURE divides this factor. It comes
from linear signatures or full models, model error included. Each also has a likelihood of its misfit x, the
chi-square per number:

- without a mismatch, the plain model's x is distributed as MISFIT chi-square(FREEDOM) / FREEDOM;
- with one, x follows that distribution or exceeds it at even odds (ln x uniform up to MOST_MISFIT times
  MISFIT). The true explanation leaves a share of the excess over MISFIT, exponential with mean REMAINING
  (more, if the scatter hides the excess);
- unknown physics resembles one of the explanations, has that one's log Bayes factor from the motion of the
  flesh, and leaves any share of the excess. A gel may also behave as a faulty reading would, and be read
  correctly. That is unknown physics, too: it has the same direct evidence, and the flesh is as without the
  fault. Both are then equally likely beforehand.

The verdict is the smallest set of explanations whose probabilities add up to CREDIBLE. An effect in it
includes every pair that contains the effect. If the p-value is at least DETECTION_P, the set contains "none",
and only "none" if that is also the likeliest explanation.

The p-value needs no bank of recordings. Without a mismatch, the products b of the signatures with the data
come from noise and from the model's own error, whose scale has a heavy tail
(fem.mismatch.evidence.model_error). Draws of b give the distribution of its statistics.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc, gammaln, logsumexp

from fem.mismatch.evidence.model_error import NullDraws
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.result import NONE

DETECTION_P = 0.05
"""p-value below which there is a mismatch: the usual level."""
CREDIBLE = 0.95
"""Least probability of the verdict's set."""
PRIOR: Mapping[str, float] = {NONE: 0.5, "single": 0.45, "pair": 0.05}
"""Probabilities before the data; equal for all effects and for all pairs. Set by hand: half of all fruit have
no mismatch."""
OUTSIDE = 0.025
"""Prior probability that physics outside the catalogue causes what looks like any of these: its share of the
bank's cases (6 of 236)."""
TEMPERATURE = 1.5
"""Divisor of log Bayes factors. Set by hand; the log score of 30 cases of the bank is flat from 1.5 to 3
(`benchmarks/mismatch_scores.py`)."""
MISFIT, FREEDOM = 0.0371, 37.0
"""Mean and degrees of freedom of the chi-square per number that the plain model leaves of
recordings without mismatch: seventeen fruit (`benchmarks/results/null-fruit.csv`)."""
MOST_MISFIT = 1000.0
"""Greatest misfit by a mismatch, over MISFIT. Set by hand: a grasp's signal over its noise."""
REMAINING = 0.12
"""Mean share of the excess misfit that the true explanation leaves. Set by hand: with a misfit of
30 times the usual an explanation that leaves 0.75 of the excess is then as likely as unknown physics."""
DRAWS = 2000
"""Draws of b without mismatch: p is known to 0.005 at DETECTION_P."""


@dataclass(frozen=True, kw_only=True)
class Weighed:
    """One explanation before its probability. `gain`: log Bayes factor over the plain model. `direct`: the
    part of `gain` from evidence that does not depend on the flesh. `read_correctly`: log Bayes factor if the
    gel behaves as the faulty reading would and is read correctly; None without a fault of a gel. `hidden`:
    evidence against it that errors of its laws explain, less that of the best explanation; it is added to
    `gain`. `misfit`: its chi-square per number. `tenable`: False if its full model cannot be computed;
    unknown physics may still resemble it.
    """

    name: str
    gain: float
    misfit: float
    direct: float = 0.0
    read_correctly: float | None = None
    hidden: float = 0.0
    tenable: bool = True


def log_prior(name: str, *, effects: int) -> float:
    """Log prior probability of an explanation among so many effects; "+" joins the effects of a pair.

    >>> round(float(np.exp(log_prior("none", effects=26))), 3)
    0.5
    """
    if name == NONE:
        return float(np.log(PRIOR[NONE]))
    if "+" in name:
        return float(np.log(PRIOR["pair"] / max(effects * (effects - 1) / 2, 1)))
    return float(np.log(PRIOR["single"] / effects))


def probabilities(
    explanations: Sequence[Weighed], *, temperature: float | None = None
) -> tuple[Float[np.ndarray, " h"], float]:
    """Of each of the explanations, including "none", and of "unknown"; `temperature`: default TEMPERATURE."""
    temperature = TEMPERATURE if temperature is None else temperature
    before = next(explanation.misfit for explanation in explanations if explanation.name == NONE)
    usual = log_usual(before)
    uniform = -float(np.log(np.log(MOST_MISFIT))) if before > MISFIT else -np.inf
    present = float(np.logaddexp(usual, uniform) - np.log(2.0))
    scatter = MISFIT * np.sqrt(2 / FREEDOM)
    excess = max(before - MISFIT, scatter)
    mean = min(REMAINING + scatter / excess, 1.0)
    effects = sum(explanation.name != NONE and "+" not in explanation.name for explanation in explanations)
    named, resembled = [], []
    for explanation in explanations:
        gain = (explanation.gain + explanation.hidden) / temperature
        remaining = max(explanation.misfit - MISFIT, 0.0) / excess
        left = -np.log(mean) - remaining / mean
        prior = log_prior(explanation.name, effects=effects)
        as_named = prior + gain + (usual if explanation.name == NONE else present + left)
        named.append(as_named if explanation.tenable else -np.inf)
        apart = gain - explanation.direct / temperature
        if explanation.read_correctly is not None:
            apart = np.logaddexp(apart, explanation.read_correctly / temperature) - np.log(2.0)
        resembled.append(prior + apart + present)
    inside, outside = np.array(named) + np.log(1 - OUTSIDE), np.array(resembled) + np.log(OUTSIDE)
    total = logsumexp([*inside, *outside])
    return np.exp(inside - total), float(np.exp(logsumexp(outside) - total))


def log_usual(misfit: float) -> float:
    """ln density of ln x without a mismatch: a scaled chi-square."""
    half, ratio = FREEDOM / 2, max(misfit / MISFIT, 1e-9)
    return float(half * np.log(half) - gammaln(half) + half * (np.log(ratio) - ratio))


def credible_set(names: Sequence[str], probability: Sequence[float]) -> tuple[str, ...]:
    """The fewest names that together have CREDIBLE, likeliest first; a name includes pairs that contain it.

    >>> credible_set(["skin", "none", "slip"], [0.9, 0.08, 0.02])
    ('skin', 'none')
    >>> credible_set(["skin", "skin+slip", "none"], [0.9, 0.08, 0.02])
    ('skin',)
    """
    share, parts = np.asarray(probability), [set(name.split("+")) for name in names]
    covered = np.zeros(len(names), dtype=bool)
    chosen: list[str] = []
    for k in np.argsort(-share, kind="stable"):
        if not covered[k]:
            chosen.append(names[k])
            covered |= [parts[k] <= other for other in parts]
            if share[covered].sum() >= CREDIBLE - 1e-12:
                break
    return tuple(chosen)


def verdict_of(probability: Mapping[str, float], *, p_value: float) -> tuple[str, ...]:
    """The verdict from the probabilities of all explanations and the p-value.

    >>> verdict_of({"none": 0.6, "skin": 0.4}, p_value=0.3)
    ('none',)
    >>> verdict_of({"none": 0.01, "skin": 0.99}, p_value=0.06)
    ('skin', 'none')
    >>> verdict_of({"none": 0.01, "skin": 0.99}, p_value=0.04)
    ('skin',)
    """
    detected = p_value < DETECTION_P
    if not detected and max(probability, key=probability.__getitem__) == NONE:
        return (NONE,)
    names = credible_set(list(probability), list(probability.values()))
    return names if detected or NONE in names else (*names, NONE)


@dataclass(frozen=True, kw_only=True)
class Detection:
    """The test for a mismatch: the p-value of each statistic."""

    p_values: dict[str, float]

    @property
    def p_value(self) -> float:
        """The smallest p-value, corrected for their number (Sidak)."""
        return float(-np.expm1(len(self.p_values) * np.log1p(-min(min(self.p_values.values()), 1 - 1e-12))))

    @property
    def mismatch(self) -> bool:
        """Whether there is one."""
        return self.p_value < DETECTION_P


def detection(
    equations: SignatureEquations,
    null_draws: NullDraws,
    *,
    misfit: float,
    direct: float,
    against: Mapping[str, Sequence[float]] | None = None,
    rng: np.random.Generator,
) -> Detection:
    """The test on the recordings of a case.

    "effects": the mean Bayes factor over the catalogue; `against`: other evidence against each signature, as
    log likelihood by effect. The draws omit it, as its distribution is unknown, so p is conservative.
    "misfit": x of the plain model. "gel": `direct`, the log Bayes factor of evidence from the gels alone;
    a Bayes factor above c has a probability of at most 1/c without mismatch (Markov).
    """
    each = {"misfit": misfit_p_value(misfit)}
    if any(len(ways) for ways in equations.ways.values()):
        observed = _catalogue(equations, equations.right[None], against)[0]
        drawn = _catalogue(equations, null_draws.drawn(DRAWS, rng))
        each["effects"] = float((1 + (drawn >= observed).sum()) / (DRAWS + 1))
    if direct > 0:
        each["gel"] = float(np.exp(-direct))
    return Detection(p_values=each)


def misfit_p_value(misfit: float) -> float:
    """Probability of at least this misfit of the plain model without a mismatch."""
    return float(gammaincc(FREEDOM / 2, FREEDOM / 2 * max(misfit, 0.0) / MISFIT))


def _catalogue(
    equations: SignatureEquations,
    right: Float[np.ndarray, "d c"],
    said: Mapping[str, Sequence[float]] | None = None,
) -> Float[np.ndarray, " d"]:
    """ln of the sum of all effects' Bayes factors over none, for d data b."""
    return np.asarray(logsumexp(list(equations.log_bayes_factors(right, said=said).values()), axis=0))

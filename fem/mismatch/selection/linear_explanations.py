"""All explanations by linear signatures: none, every effect, and every pair that the data speak for.

An effect's evidence is the mean over its signatures. A pair is the effect of the greater evidence and a
second one by what it adds beside the first, above the error of the first one's law (LAW_ERROR of
fem.mismatch.selection.decision). A second effect that adds nothing is no explanation of its own.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.gel_fault import is_of_relation
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import LAW_ERROR, Weighed, probabilities
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.screening import (
    LinearFit,
    LinearRound,
    modulus_change,
    violates_sign_constraint,
    without_model_error,
)


@dataclass(frozen=True, kw_only=True)
class Hypothesis(Weighed):
    """One explanation, and the linear fits of its effects: none for "none", two for a pair.

    `modulus_change`: E with the effects over E without, and the relative standard deviation that they add, by
    linear signatures; None for unknown physics, which leaves any `misfit`. `probability`: among all, by
    `ranked`. `refit`: its full model. `alternatives`: the same with another pad, where that gains about as
    much: its share of the explanation's probability, and its refit.
    """

    misfit: float = float("nan")
    linear_fits: tuple[LinearFit, ...] = ()
    modulus_change: tuple[float, float] | None = (1.0, 0.0)
    probability: float = float("nan")
    refit: Refit | None = None
    alternatives: tuple[tuple[float, Refit], ...] = ()


def ranked(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """All that are tenable with their probabilities, and "unknown", the likeliest first."""
    weighed = list(hypotheses)
    shares, unknown = probabilities(weighed)
    ranking = [
        replace(hypothesis, probability=float(share))
        for hypothesis, share in zip(weighed, shares, strict=True)
        if hypothesis.tenable
    ]
    most = max(hypothesis.gain for hypothesis in weighed)
    ranking.append(Hypothesis(name=UNKNOWN, gain=most, probability=unknown, modulus_change=None))
    return sorted(ranking, key=lambda hypothesis: -hypothesis.probability)


def linear_explanations(linear: LinearRound) -> list[Hypothesis]:
    """The explanations, "none" last."""
    singles = [_single(linear, fits) for fits in _ways(linear.linear_fits)]
    singles.sort(key=lambda single: -single.gain)
    none = Hypothesis(name=NONE, gain=0.0, misfit=misfit_left(linear, ()))
    return [*singles, *_pairs(linear, singles), none]


def misfit_left(linear: LinearRound, fits: Sequence[LinearFit]) -> float:
    """The chi-square per number that these linear fits leave."""
    return (linear.null.chi2 - sum(fit.chi2_drop for fit in fits)) / linear.numbers


def _ways(fits: Sequence[LinearFit]) -> list[list[LinearFit]]:
    """The signatures of each effect, the best first."""
    ways: dict[str, list[LinearFit]] = {}
    for fit in sorted(fits, key=lambda fit: -fit.gain):
        ways.setdefault(fit.name, []).append(fit)
    return list(ways.values())


def _mean(gains: Sequence[float]) -> float:
    """ln of the mean Bayes factor."""
    return float(logsumexp(gains) - np.log(len(gains)))


def _single(linear: LinearRound, fits: Sequence[LinearFit]) -> Hypothesis:
    best = fits[0]
    return Hypothesis(
        name=best.name,
        gain=_mean([fit.gain for fit in fits]),
        misfit=misfit_left(linear, (best,)),
        direct=best.direct,
        linear_fits=(best,),
        modulus_change=_mixture(fits),
    )


def _mixture(fits: Sequence[LinearFit]) -> tuple[float, float]:
    """Of `modulus_change` over the signatures, by their evidence: which pad has a gain may be unknown."""
    gains = np.array([fit.gain for fit in fits])
    share = np.exp(gains - logsumexp(gains))
    changes, added = np.array([fit.modulus_change for fit in fits]).T
    mean = float(share @ changes)
    return mean, float(np.sqrt(share @ (added**2 + (changes - mean) ** 2)))


def _pairs(linear: LinearRound, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Each effect with every one of smaller evidence, if that adds something beside it.

    Not two faults of one gel relation, each of which shows in part as the other.
    """
    pairs = []
    ways = {fits[0].name: fits for fits in _ways(linear.linear_fits)}
    for number, first in enumerate(singles):
        (fit,) = first.linear_fits
        remaining = linear.equations
        if fit.columns:  # else it is seen directly, and leaves the motion as it is
            remaining = remaining.given(remaining.numbers(fit.columns), law_error=LAW_ERROR)
        for second in singles[number + 1 :]:
            if is_of_relation(fit.effect) and is_of_relation(second.linear_fits[0].effect):
                continue
            added = [_second(linear, remaining, way) for way in ways[second.name]]
            gain = _mean([way.gain for way in added])
            best = max(added, key=lambda way: way.gain)
            if gain > 0 and best.gain > 0:
                both = linear.products.fit([*linear.nuisances, *fit.columns, *best.columns])
                best = replace(best, chi2_drop=linear.null.chi2 - fit.chi2_drop - both.chi2)
                pairs.append(
                    Hypothesis(
                        name="+".join(sorted((first.name, second.name))),
                        gain=first.gain + gain,
                        misfit=misfit_left(linear, (fit, best)),
                        direct=first.direct + best.direct,
                        linear_fits=(fit, best),
                        modulus_change=modulus_change(
                            linear.products,
                            without_model_error(linear.products, linear.nuisances),
                            both,
                            (*fit.columns, *best.columns),
                        ),
                    )
                )
    return pairs


def _second(linear: LinearRound, equations: SignatureEquations, fit: LinearFit) -> LinearFit:
    """A signature's fit beside a first effect: gain and amounts are what it adds."""
    if not fit.columns:
        return fit
    numbers = equations.numbers(fit.columns)
    amounts = equations.amounts(numbers)
    moved = float(equations.log_bayes_factor(numbers, equations.right[None])[0])
    wrong = violates_sign_constraint(linear.products, fit.columns, amounts)
    said = min(fit.auxiliary_log_likelihood - fit.direct, max(moved, 0.0))
    return replace(fit, amounts=amounts, gain=-np.inf if wrong else moved + said + fit.direct)

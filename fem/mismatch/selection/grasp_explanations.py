"""All explanations: none, every effect, and every pair that the data support.

An effect's evidence is the mean over its signatures, or that of its full model after a refit. A pair is the
effect of the greater evidence and a second one. The second counts by the evidence that its signature adds to
the first, above the error of the first one's law (`law_error` of fem.mismatch.effect_spec). A second effect
that adds nothing makes no pair.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.gel_fault import is_of_relation
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import Weighed, probabilities
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
    linear signatures; None for unknown physics, which leaves any `misfit`. `probability`: among all, from
    `ranked`. `refit`: its full model, which then gives `misfit`, and `gain` for a single effect.
    `alternatives`: the same effects on another pad with a similar gain: share of the explanation's
    probability, and refit.
    """

    misfit: float = float("nan")
    linear_fits: tuple[LinearFit, ...] = ()
    modulus_change: tuple[float, float] | None = (1.0, 0.0)
    probability: float = float("nan")
    refit: Refit | None = None
    alternatives: tuple[tuple[float, Refit], ...] = ()


def ranked(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """All tenable explanations with their probabilities, and "unknown", the likeliest first."""
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


def all_explanations(
    linear: LinearRound, in_full: Mapping[str, Hypothesis] | None = None
) -> list[Hypothesis]:
    """The explanations, "none" last. `in_full`: those with a full model, by name. In a pair the second effect
    still counts by its signature, but the pair for no more than its full model.
    """
    known = in_full or {}
    singles = [known.get(fits[0].name) or _single(linear, fits) for fits in _ways(linear.linear_fits)]
    singles.sort(key=lambda single: -single.gain)
    pairs = [_no_better_than(known.get(pair.name), pair) for pair in _pairs(linear, singles)]
    none = Hypothesis(name=NONE, gain=0.0, misfit=misfit_left(linear, ()))
    return [*singles, *pairs, none]


def _no_better_than(in_full: Hypothesis | None, pair: Hypothesis) -> Hypothesis:
    if in_full is None:
        return pair
    return replace(in_full, gain=min(pair.gain, in_full.gain), direct=pair.direct)


def misfit_left(linear: LinearRound, fits: Sequence[LinearFit]) -> float:
    """The chi-square per number that these linear fits leave."""
    return (linear.null.chi2 - sum(fit.chi2_drop for fit in fits)) / linear.numbers


def _ways(fits: Sequence[LinearFit]) -> list[list[LinearFit]]:
    """The signatures of each effect, the best first."""
    ways: dict[str, list[LinearFit]] = {}
    for fit in sorted(fits, key=lambda fit: -fit.gain):
        ways.setdefault(fit.name, []).append(fit)
    return list(ways.values())


def mean_gain(gains: Sequence[float]) -> float:
    """ln of the mean Bayes factor."""
    return float(logsumexp(gains) - np.log(len(gains)))


def _single(linear: LinearRound, fits: Sequence[LinearFit]) -> Hypothesis:
    best = fits[0]
    return Hypothesis(
        name=best.name,
        gain=mean_gain([fit.gain for fit in fits]),
        misfit=misfit_left(linear, (best,)),
        direct=best.direct,
        linear_fits=(best,),
        modulus_change=_mixture(fits),
    )


def _mixture(fits: Sequence[LinearFit]) -> tuple[float, float]:
    """Mixture of `modulus_change` over the signatures, weighted by evidence: the pad may be unknown."""
    gains = np.array([fit.gain for fit in fits])
    share = np.exp(gains - logsumexp(gains))
    changes, added = np.array([fit.modulus_change for fit in fits]).T
    mean = float(share @ changes)
    return mean, float(np.sqrt(share @ (added**2 + (changes - mean) ** 2)))


def _pairs(linear: LinearRound, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Each effect with every one of smaller evidence that adds evidence to it.

    Two faults of one gel relation make no pair: each partly resembles the other.
    """
    pairs = []
    ways = {fits[0].name: fits for fits in _ways(linear.linear_fits)}
    for number, first in enumerate(singles):
        (fit,) = first.linear_fits
        remaining, signal = _equations_after(linear, first)
        for second in singles[number + 1 :]:
            if is_of_relation(fit.effect) and is_of_relation(second.linear_fits[0].effect):
                continue
            added = [_second(linear, fit, way, remaining, signal) for way in ways[second.name]]
            gain = mean_gain([way.gain for way in added])
            best = max(added, key=lambda way: way.gain)
            if gain > 0 and best.gain > 0:
                columns = (*fit.columns, *best.columns)
                drop = remaining.given(remaining.numbers(best.columns))[1] if best.columns else 0.0
                pairs.append(
                    Hypothesis(
                        name="+".join(sorted((first.name, second.name))),
                        gain=first.gain + gain,
                        misfit=first.misfit - drop / linear.numbers,
                        direct=first.direct + best.direct,
                        linear_fits=(fit, best),
                        modulus_change=modulus_change(
                            linear.products,
                            without_model_error(linear.products, linear.nuisances),
                            linear.products.fit([*linear.nuisances, *columns]),
                            columns,
                        ),
                    )
                )
    return pairs


def _equations_after(linear: LinearRound, first: Hypothesis) -> tuple[SignatureEquations, float]:
    """The equations of all signatures given a first effect, and the signal that it explains."""
    (fit,) = first.linear_fits
    if first.refit is not None and first.refit.others is not None:
        return first.refit.others, max(first.refit.signal, 0.0)
    if not fit.columns:  # its evidence is direct: it does not change the motion
        return linear.equations, 0.0
    equations, signal = linear.equations.given(linear.equations.numbers(fit.columns))
    return equations, max(signal, 0.0)


def _second(
    linear: LinearRound, first: LinearFit, fit: LinearFit, equations: SignatureEquations, signal: float
) -> LinearFit:
    """A signature's fit given a first effect; its gain is the evidence that it adds to the error of the
    first one's law.
    """
    if not fit.columns:
        return fit
    numbers = equations.numbers(fit.columns)
    share = first.effect.spec.law_error
    noisy = equations.with_law_error(numbers, signal=signal, share=share)
    amounts = noisy.amounts(numbers)
    moved = float(noisy.log_bayes_factor(numbers, noisy.right[None])[0])
    wrong = violates_sign_constraint(linear.products, fit.columns, amounts)
    said = min(fit.auxiliary_log_likelihood - fit.direct, max(moved, 0.0))
    return replace(fit, amounts=amounts, gain=-np.inf if wrong else moved + said + fit.direct)

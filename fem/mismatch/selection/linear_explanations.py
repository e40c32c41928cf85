"""All explanations by linear signatures: none, every effect, and every pair that the data speak for.

An effect's evidence is the mean over its signatures. A pair is the effect of the greater evidence and a
second one by what it adds beside the first, above the error of the first one's law (LAW_ERROR of
fem.mismatch.selection.decision). A second effect that adds nothing is no explanation of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.gel_fault import faults_of_relation
from fem.mismatch.result import NONE
from fem.mismatch.selection.decision import LAW_ERROR, Weighed
from fem.mismatch.selection.screening import (
    LinearFit,
    LinearRound,
    modulus_change,
    violates_sign_constraint,
)


@dataclass(frozen=True, kw_only=True)
class LinearExplanation:
    """One explanation, and the linear fits of its effects: none for "none", two for a pair.

    `modulus_change`: E with the effects over E without, and the relative standard deviation that they add.
    """

    weighed: Weighed
    linear_fits: tuple[LinearFit, ...] = ()
    modulus_change: tuple[float, float] = (1.0, 0.0)

    @property
    def name(self) -> str:
        """Effects' names, sorted and joined."""
        return self.weighed.name


def linear_explanations(linear: LinearRound, *, kept: float = 1.0) -> list[LinearExplanation]:
    """The explanations, "none" last. `kept`: share of the frames, of thinned recordings."""
    singles = [_single(fits) for fits in _ways(linear.linear_fits)]
    singles.sort(key=lambda single: -single.weighed.gain)
    found = [*singles, *_pairs(linear, singles), LinearExplanation(weighed=Weighed(name=NONE, gain=0.0))]
    return [with_misfit(linear, explanation, kept=kept) for explanation in found]


def with_misfit(
    linear: LinearRound, explanation: LinearExplanation, *, kept: float = 1.0
) -> LinearExplanation:
    """The same with the chi-square per number that its linear fits leave."""
    left = linear.null.chi2 - sum(fit.chi2_drop for fit in explanation.linear_fits)
    return replace(explanation, weighed=replace(explanation.weighed, misfit=kept * left / linear.numbers))


def _ways(fits: Sequence[LinearFit]) -> list[list[LinearFit]]:
    """The signatures of each effect, the best first."""
    ways: dict[str, list[LinearFit]] = {}
    for fit in sorted(fits, key=lambda fit: -fit.gain):
        ways.setdefault(fit.name, []).append(fit)
    return list(ways.values())


def _mean(gains: Sequence[float]) -> float:
    """ln of the mean Bayes factor."""
    return float(logsumexp(gains) - np.log(len(gains)))


def _single(fits: Sequence[LinearFit]) -> LinearExplanation:
    best = fits[0]
    gain = _mean([fit.gain for fit in fits])
    return LinearExplanation(
        weighed=Weighed(name=best.name, gain=gain, direct=best.direct),
        linear_fits=(best,),
        modulus_change=best.modulus_change,
    )


def _pairs(linear: LinearRound, singles: Sequence[LinearExplanation]) -> list[LinearExplanation]:
    """Each effect with every one of smaller evidence, if that adds something beside it.

    Two faults of one gel relation show in part as each other: those are
    fem.mismatch.selection.fault_pairs.
    """
    found = []
    ways = {fits[0].name: fits for fits in _ways(linear.linear_fits)}
    for number, first in enumerate(singles):
        (fit,) = first.linear_fits
        remaining = linear.equations
        if fit.columns:  # else it is seen directly, and leaves the motion as it is
            remaining = remaining.given(remaining.numbers(fit.columns), law_error=LAW_ERROR)
        for second in singles[number + 1 :]:
            if len(faults_of_relation([fit.effect, second.linear_fits[0].effect])) == 2:
                continue
            added = [_second(linear, remaining, way) for way in ways[second.name]]
            gain = _mean([way.gain for way in added])
            best = max(added, key=lambda way: way.gain)
            if gain > 0 and best.gain > 0:
                weighed = Weighed(
                    name="+".join(sorted((first.name, second.name))),
                    gain=first.weighed.gain + gain,
                    direct=first.weighed.direct + best.direct,
                )
                both = linear.products.fit([*linear.nuisances, *fit.columns, *best.columns])
                found.append(
                    LinearExplanation(
                        weighed=weighed,
                        linear_fits=(fit, best),
                        modulus_change=modulus_change(linear.null, both),
                    )
                )
    return found


def _second(linear: LinearRound, equations: SignatureEquations, fit: LinearFit) -> LinearFit:
    """A signature's fit beside a first effect: gain, amounts and fall of chi-square are what it adds."""
    if not fit.columns:
        return fit
    own = equations.numbers(fit.columns)
    amounts = equations.amounts(own)
    moved = float(equations.log_bayes_factor(own, equations.right[None])[0])
    wrong = violates_sign_constraint(linear.products, fit.columns, amounts)
    said = min(fit.auxiliary_log_likelihood - fit.direct, max(moved, 0.0))
    return replace(
        fit,
        amounts=amounts,
        gain=-np.inf if wrong else moved + said + fit.direct,
        chi2_drop=0.0 if wrong else float(equations.right[list(own)] @ amounts),
    )

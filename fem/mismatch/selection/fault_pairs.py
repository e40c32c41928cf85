"""Two faults of one gel at once: what force against displacement of the gel shows of both together.

Fitted alone, a fault absorbs a part of the other, comes out too large or too small, and the flesh contradicts
it. So both are fitted together, whether or not the second shows alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fem.mismatch.effect import Effect, SeenDirectly, Signature
from fem.mismatch.gel_fault import LEAST_EVIDENCE, GelFault, faults_of_relation, fitted_together
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.selection.decision import Weighed
from fem.mismatch.selection.linear_explanations import LinearExplanation, misfit_left
from fem.mismatch.selection.screening import LinearFit, LinearRound
from fem.mismatch.signature_variant import ONE_WAY


def direct_evidence(forward: ForwardModel, effects: Sequence[Effect]) -> float:
    """What the recordings show directly of all these effects; of several faults of the gel together."""
    faults = faults_of_relation(effects)
    alone = [effect for effect in effects if len(faults) < 2 or effect not in faults]
    total = sum(effect.direct_evidence(forward) for effect in alone if isinstance(effect, SeenDirectly))
    together = fitted_together(forward, faults) if len(faults) > 1 else None
    return total + (0.0 if together is None else together.evidence)


@dataclass(frozen=True, kw_only=True)
class SecondFault:
    """A fault that the relation shows beside another; `evidence`: what it adds. `starts`: parameters of the
    first and of this one, as fitted together.
    """

    fault: GelFault
    evidence: float
    starts: tuple[dict[str, float], dict[str, float]]


def second_faults(forward: ForwardModel, faults: Sequence[GelFault], first: GelFault) -> list[SecondFault]:
    """Those of `faults` that the relation shows beside the first."""
    before = fitted_together(forward, (first,))
    if before is None:
        return []
    seconds = []
    for fault in faults_of_relation([fault for fault in faults if fault is not first]):
        both = fitted_together(forward, faults_of_relation([first, fault]))
        added = 0.0 if both is None else both.evidence - before.evidence
        if both is not None and added >= LEAST_EVIDENCE:
            starts = (first.within_bounds(both.values), fault.within_bounds(both.values))
            seconds.append(SecondFault(fault=fault, evidence=added, starts=starts))
    return seconds


def fault_pairs(
    forward: ForwardModel, linear: LinearRound, singles: Sequence[LinearExplanation]
) -> dict[str, tuple[LinearExplanation, SecondFault]]:
    """By name, the best fault among the single explanations with every second one that shows beside it."""
    shown = [
        single
        for single in singles
        if len(single.linear_fits) == 1
        and single.weighed.direct > 0
        and faults_of_relation([single.linear_fits[0].effect])
    ]
    if not shown:
        return {}
    best = max(shown, key=lambda single: single.weighed.gain)
    (first,) = faults_of_relation([best.linear_fits[0].effect])
    pairs = {}
    for second in second_faults(forward, linear.gel_faults, first):
        name = "+".join(sorted((best.name, second.fault.spec.name)))
        weighed = Weighed(
            name=name,
            gain=best.weighed.gain + second.evidence,
            misfit=misfit_left(linear, best.linear_fits),
            direct=best.weighed.direct + second.evidence,
        )
        fits = (*best.linear_fits, _without_signature(second))
        explanation = LinearExplanation(weighed=weighed, linear_fits=fits, modulus_change=best.modulus_change)
        pairs[name] = (explanation, second)
    return pairs


def _without_signature(second: SecondFault) -> LinearFit:
    """A fault of the gel by what the relation shows of it beside another, whatever it shows alone."""
    return LinearFit(
        effect=second.fault,
        signature=Signature(variant=ONE_WAY, columns=()),
        columns=(),
        amounts=np.zeros(0),
        gain=second.evidence,
        auxiliary_log_likelihood=second.evidence,
        chi2_drop=0.0,
        modulus_change=(1.0, 0.0),
        direct=second.evidence,
    )

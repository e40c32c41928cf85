"""Forward selection: which other signature adds most to an effect that has been refitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from fem.mismatch.effect import Effect, SeenDirectly
from fem.mismatch.gel_fault import LEAST_EVIDENCE, GelFault, faults_of_relation, fitted_together
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.retained_columns import retained_columns
from fem.mismatch.selection.screening import (
    LinearFit,
    LinearRound,
    log_positive,
    modulus_change,
    violates_sign_constraint,
)


def direct_evidence(forward: ForwardModel, effects: Sequence[Effect]) -> float:
    """What the recordings show directly of all these effects; of several faults of the gel together."""
    faults = faults_of_relation(effects)
    alone = [effect for effect in effects if len(faults) < 2 or effect not in faults]
    total = sum(one.direct_evidence(forward) for one in alone if isinstance(one, SeenDirectly))
    together = fitted_together(forward, faults) if len(faults) > 1 else None
    return total + (0.0 if together is None else together.evidence)


@dataclass(frozen=True, kw_only=True)
class SecondFault:
    """A fault of the gel that the relation shows beside those of a refit; `evidence`: what it adds to theirs.

    `starts`: parameters of the refit's effects and of this one, of all faults as fitted together.
    """

    fault: GelFault
    evidence: float
    starts: tuple[dict[str, float], ...]


def second_faults(linear: LinearRound, known: Refit) -> dict[str, SecondFault]:
    """Other faults of the gel that the relation shows beside those of a refit, by name.

    Fitted alone, a fault absorbs a part of the other, comes out too large or too small, and the flesh
    contradicts it.
    """
    first = faults_of_relation(known.effects)
    before = fitted_together(known.forward, first) if first else None
    if before is None:
        return {}
    found = {}
    for fault in faults_of_relation(linear.gel_faults):
        both = None if fault in first else fitted_together(known.forward, faults_of_relation([*first, fault]))
        added = 0.0 if both is None else both.evidence - before.evidence
        if both is None or added < LEAST_EVIDENCE:
            continue
        starts = [
            one.within_bounds(both.values) if isinstance(one, GelFault) and one.of_the_relation else dict(own)
            for one, own in zip((*known.effects, fault), (*known.parameters, {}), strict=True)
        ]
        found[fault.spec.name] = SecondFault(fault=fault, evidence=added, starts=tuple(starts))
    return found


def added_gains(linear: LinearRound, known: Refit) -> list[tuple[float, LinearFit]]:
    """Signatures of other effects, linearised about the refitted model: ln evidence added, and the fit.

    Greatest first, without those that violate a sign constraint. The refitted effect's own parameters stay
    free along their slopes; `modulus_change` of the fit is that of E beside the refitted effect.
    """
    mine = {effect.spec.name for effect in known.effects}
    others = [one for one in linear.linear_fits if one.effect.spec.name not in mine]
    columns = [j for one in others for j in one.columns]
    slopes = [known.products.columns[j] for j in known.slopes]
    plain = retained_columns(known.effects, linear.products.columns, linear.nuisances)
    products, chosen = linear.products.about(known.forward, known.response, [*plain, *columns], slopes)
    place = dict(zip([*plain, *columns], chosen, strict=False))
    free = [*(place[j] for j in plain), *chosen[len(chosen) - len(slopes) :]]
    before = products.fit(free)
    shown = direct_evidence(known.forward, known.effects)
    conditional = {
        effect.spec.name: direct_evidence(known.forward, (*known.effects, effect)) - shown
        for effect in {one.name: one.effect for one in others if one.direct}.values()
    }
    found: list[tuple[float, LinearFit]] = []
    for one in others:
        own = [place[j] for j in one.columns]
        fit = products.fit([*free, *own])
        amounts = fit.amounts[len(fit.amounts) - len(own) :]
        if not violates_sign_constraint(products, own, amounts):
            gain = fit.log_evidence - before.log_evidence + conditional.get(one.name, 0.0)
            gain += log_positive(products, own, fit)
            change = modulus_change(before, fit)
            found.append((gain, replace(one, amounts=amounts, modulus_change=change)))
    return sorted(found, key=lambda pair: -pair[0])

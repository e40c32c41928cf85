"""Forward selection: which other signature adds most to an effect that has been refitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fem.mismatch.effect import Effect, SeenDirectly
from fem.mismatch.gel_fault import GelFault
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.retained_columns import retained_columns
from fem.mismatch.selection.screening import (
    LinearFit,
    LinearRound,
    modulus_spread_of,
    violates_sign_constraint,
)

ALTERNATIONS = 3
"""Fits of each fault of the gel beside the others. A creep of 0.151 (0.166 alone) comes out as 0.153, 0.151
and 0.151 beside a loop of 0.090 (0.180 alone), that as 0.080, 0.089 and 0.090 (case 012 of the second sealed
proof)."""


def direct_evidence(
    forward: ForwardModel, effects: Sequence[Effect], parameters: Sequence[Mapping[str, float]]
) -> float:
    """What the recordings show directly of effects with these parameters, each beside those before it.

    The parameters of the last do not matter.
    """
    total = 0.0
    for number, effect in enumerate(effects):
        faults = gel_faults(effects[:number], parameters[:number])
        if isinstance(effect, GelFault) and faults:
            beside = effect.beside(forward, faults)
            total += 0.0 if beside is None else beside.evidence
        elif isinstance(effect, SeenDirectly):
            total += effect.direct_evidence(forward)
    return total


def gel_faults(
    effects: Sequence[Effect], parameters: Sequence[Mapping[str, float]]
) -> list[tuple[GelFault, Mapping[str, float]]]:
    """Those of the effects that are faults of the gel, with their parameters."""
    both = zip(effects, parameters, strict=True)
    return [(effect, own) for effect, own in both if isinstance(effect, GelFault)]


@dataclass(frozen=True, kw_only=True)
class FaultBeside:
    """A fault of the gel that shows beside those of a refit, and its `evidence` beside them.

    `starts`: parameters of the refit's effects and of this one, of all faults as they show beside each other.
    """

    fault: GelFault
    evidence: float
    starts: tuple[dict[str, float], ...]


def faults_beside(linear: LinearRound, known: Refit) -> dict[str, FaultBeside]:
    """Other faults of the gel that show beside those of a refit, by name: without one of those undone they
    show too much, so that the flesh contradicts them, or too little.
    """
    mine = {effect.spec.name for effect in known.effects}
    if not gel_faults(known.effects, known.parameters):
        return {}
    found = {}
    for fault in linear.gel_faults:
        if fault.spec.name in mine:
            continue
        first = fault.beside(known.forward, gel_faults(known.effects, known.parameters))
        if first is None:
            continue
        effects = (*known.effects, fault)
        starts = _each_beside_the_others(known.forward, effects, (*known.parameters, first.values))
        last = fault.beside(known.forward, gel_faults(known.effects, starts[:-1]))
        evidence = 0.0 if last is None else last.evidence
        found[fault.spec.name] = FaultBeside(fault=fault, evidence=evidence, starts=starts)
    return found


def _each_beside_the_others(
    forward: ForwardModel, effects: Sequence[Effect], parameters: Sequence[Mapping[str, float]]
) -> tuple[dict[str, float], ...]:
    """The parameters with those of faults of the gel fitted in turn, all others undone."""
    values = [dict(own) for own in parameters]
    for _ in range(ALTERNATIONS):
        for number, effect in enumerate(effects):
            if not isinstance(effect, GelFault):
                continue
            others = [(one, own) for one, own in gel_faults(effects, values) if one is not effect]
            again = effect.beside(forward, others)
            if again is not None:
                values[number] = effect.within_bounds(again.values)
    return tuple(values)


def added_gains(linear: LinearRound, known: Refit) -> list[tuple[float, LinearFit]]:
    """Signatures of other effects, linearised about the refitted model: ln evidence added, and the fit.

    Greatest first, without those that violate a sign constraint. The refitted effect's own parameters stay
    free along their slopes; `modulus_spread` of the fit is that of E beside the refitted effect.
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
    shown = direct_evidence(known.forward, known.effects, known.parameters)
    conditional = {
        effect.spec.name: direct_evidence(known.forward, (*known.effects, effect), (*known.parameters, {}))
        - shown
        for effect in {one.name: one.effect for one in others if one.direct}.values()
    }
    found: list[tuple[float, LinearFit]] = []
    for one in others:
        own = [place[j] for j in one.columns]
        fit = products.fit([*free, *own])
        amounts = fit.amounts[len(fit.amounts) - len(own) :]
        if not violates_sign_constraint(products, own, amounts):
            gain = fit.log_evidence - before.log_evidence + conditional.get(one.name, 0.0)
            spread = modulus_spread_of(before, fit)
            found.append((gain, replace(one, amounts=amounts, modulus_spread=spread)))
    return sorted(found, key=lambda pair: -pair[0])

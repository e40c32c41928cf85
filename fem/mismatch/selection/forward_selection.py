"""Forward selection: which other signature adds most to an effect that has been refitted."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

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


def direct_evidence(
    forward: ForwardModel, effects: Sequence[Effect], parameters: Sequence[Mapping[str, float]]
) -> float:
    """What the recordings show directly of effects with these parameters, each beside those before it.

    The parameters of the last do not matter.
    """
    total = 0.0
    faults: list[tuple[GelFault, Mapping[str, float]]] = []
    for effect, own in zip(effects, parameters, strict=True):
        if isinstance(effect, GelFault):
            total += (
                effect.conditional_evidence(forward, faults) if faults else effect.direct_evidence(forward)
            )
            faults.append((effect, own))
        elif isinstance(effect, SeenDirectly):
            total += effect.direct_evidence(forward)
    return total


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

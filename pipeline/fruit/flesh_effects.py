"""Adds confirmed effects of flesh and contact to the models of a fruit's grasps, by the mechanics."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.estimation.grasp_model import GraspModel
from fem.fem_failure import FemFailure
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.displacement_correction import KnownEffect, displacement_corrections
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Entry
from fem.mismatch.mismatch_case import MismatchCase
from pipeline.batch.confirmed_effects import ConfirmedEffect

MECHANICS: dict[str, Effect] = {
    effect.spec.name: effect for effect in EFFECTS if effect.spec.enters is Entry.RESPONSE
}
"""Effects that change the response of flesh or contact to a force; the others enter before there is a model,
in the recordings, the settings or the mesh."""


def catalogue_parameters(effect: ConfirmedEffect, E_MPa: float) -> dict[str, float]:
    """Parameters of the settings under the names that the effect's search has.

    Components of a vector become separate; values relative to the flesh's modulus are converted with E.
    """
    values: dict[str, float] = {}
    for parameter in effect.spec.parameters:
        value = effect.parameters[parameter.name]
        if not isinstance(value, str):
            values |= parameter.searched_values(value, E_MPa=E_MPa)
    return values


def added(
    case: MismatchCase, effects: Sequence[ConfirmedEffect], *, at_finite_strain: bool
) -> list[Float[np.ndarray, "_t _n 3"]]:
    """Displacements that these effects add to the response of each recording of `case`, neo-Hookean if
    `at_finite_strain`; raises FemFailure.
    """
    confirmed = [
        KnownEffect(effect=MECHANICS[effect.effect], parameters=partial(catalogue_parameters, effect))
        for effect in effects
    ]
    return displacement_corrections(case, confirmed, at_finite_strain=at_finite_strain)


def with_corrections(
    models: Sequence[GraspModel | FemFailure], beyond: Sequence[Float[np.ndarray, "_t _n 3"]]
) -> list[GraspModel | FemFailure]:
    """The models with `beyond`, one for each grasp that has a model, added to their displacement
    correction.
    """
    remaining = iter(beyond)
    return [
        model if isinstance(model, FemFailure) else _corrected(model, next(remaining)) for model in models
    ]


def _corrected(model: GraspModel, beyond: Float[np.ndarray, "_t _n 3"]) -> GraspModel:
    before = 0.0 if model.displacement_correction is None else model.displacement_correction
    return replace(model, displacement_correction=before + beyond)


def in_the_model(effects: Sequence[ConfirmedEffect]) -> tuple[ConfirmedEffect, ...]:
    """Effects that change the model of a grasp, without parameters that the mechanics lack."""
    return tuple(effect for effect in effects if effect.effect in MECHANICS and not _too_much(effect))


def used(effects: Sequence[ConfirmedEffect]) -> tuple[ConfirmedEffect, ...]:
    """Effects that the modulus includes."""
    model = in_the_model(effects)
    return tuple(effect for effect in effects if effect.spec.enters is not Entry.RESPONSE or effect in model)


def unused_warnings(effects: Sequence[ConfirmedEffect]) -> list[str]:
    """One warning for each effect in the settings that the modulus ignores."""
    taken = used(effects)
    return [
        f"batch.toml confirms {effect.effect} with {', '.join(_too_much(effect))}, which grading cannot "
        "take into account yet; E ignores it."
        for effect in effects
        if effect not in taken
    ]


def _too_much(effect: ConfirmedEffect) -> list[str]:
    """Further parameters of a kind (EffectParameter.numbered)."""
    return sorted(effect.parameters.keys() - {parameter.name for parameter in effect.spec.parameters})

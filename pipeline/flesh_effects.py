"""Confirmed effects of the flesh in the model of a grasp: what is passed on to the mechanics."""

from collections.abc import Callable, Mapping, Sequence

from fem.forward import UnitModulusSolid
from fem.grasp_model import GraspModel
from fem.modulus_inputs import GraspHistory
from pipeline.confirmed import OF_THE_JAWS, ConfirmedEffect, Value

Change = Callable[[GraspModel, GraspHistory, UnitModulusSolid, Mapping[str, Value]], GraspModel]
CHANGES: dict[str, Change] = {}
"""By effect: a grasp's model, its history, the solid and the effect's parameters make the model with it."""
BEFORE_THE_MODEL = OF_THE_JAWS | {"poisson_ratio", "pit_offset", "pit_size"}
"""Effects that are taken into account before there is a model: in the recordings, the settings, the mesh."""


def with_effects(
    model: GraspModel,
    history: GraspHistory,
    solid: UnitModulusSolid,
    effects: Sequence[ConfirmedEffect],
) -> GraspModel:
    """The grasp's model with every effect that the mechanics knows; raises FemFailure as they do."""
    for one in in_the_model(effects):
        model = CHANGES[one.effect](model, history, solid, one.parameters)
    return model


def in_the_model(effects: Sequence[ConfirmedEffect]) -> tuple[ConfirmedEffect, ...]:
    """Those that change the model of a grasp."""
    return tuple(one for one in effects if one.effect in CHANGES)


def used(effects: Sequence[ConfirmedEffect]) -> tuple[ConfirmedEffect, ...]:
    """Those that the modulus takes into account."""
    return tuple(one for one in effects if one.effect in BEFORE_THE_MODEL or one.effect in CHANGES)


def unused_warnings(effects: Sequence[ConfirmedEffect]) -> list[str]:
    """One warning for each effect that stands in the settings and is not in the modulus."""
    taken = used(effects)
    return [
        f"batch.toml confirms {one.effect}, which grading cannot take into account yet: E is without it."
        for one in effects
        if one not in taken
    ]

"""Confirmed effects of flesh and contact in the models of a fruit's grasps: handed to the mechanics."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.failure import FemFailure
from fem.grasp_model import GraspModel
from fem.mismatch.case import MismatchCase
from pipeline.confirmed import OF_THE_JAWS, ConfirmedEffect, Value

Departure = Float[np.ndarray, "t n 3"]
Mechanics = Callable[[MismatchCase, Mapping[str, Value]], Sequence[Departure]]
MECHANICS: dict[str, Mechanics] = {}
"""By effect: what it adds to the displacement of every recording's markers for E = 1 MPa, frame by frame."""
BEFORE_THE_MODEL = OF_THE_JAWS | {"poisson_ratio", "pit_offset", "pit_size"}
"""Effects that are taken into account before there is a model: in the recordings, the settings, the mesh."""


def with_effects(
    models: Sequence[GraspModel | FemFailure], case: MismatchCase, effects: Sequence[ConfirmedEffect]
) -> list[GraspModel | FemFailure]:
    """The models of `case`'s grasps with every effect that the mechanics knows, added to their departure.

    `case` holds the grasps that have a model, in their order. Raises FemFailure as the mechanics does.
    """
    having = [k for k, model in enumerate(models) if isinstance(model, GraspModel)]
    changed = list(models)
    for one in in_the_model(effects):
        added = MECHANICS[one.effect](case, one.parameters)
        for k, departure in zip(having, added, strict=True):
            model = changed[k]
            if isinstance(model, GraspModel):
                before = model.departure
                changed[k] = replace(model, departure=departure if before is None else before + departure)
    return changed


def in_the_model(effects: Sequence[ConfirmedEffect]) -> tuple[ConfirmedEffect, ...]:
    """Those that change the model of a grasp."""
    return tuple(one for one in effects if one.effect in MECHANICS)


def used(effects: Sequence[ConfirmedEffect]) -> tuple[ConfirmedEffect, ...]:
    """Those that the modulus takes into account."""
    return tuple(one for one in effects if one.effect in BEFORE_THE_MODEL or one.effect in MECHANICS)


def unused_warnings(effects: Sequence[ConfirmedEffect]) -> list[str]:
    """One warning for each effect that stands in the settings and is not in the modulus."""
    taken = used(effects)
    return [
        f"batch.toml confirms {one.effect}, which grading cannot take into account yet: E is without it."
        for one in effects
        if one not in taken
    ]

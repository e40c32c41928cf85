"""What the model's own error looks like: a little of some effects, seen in every sound recording.

The finer a pattern is, the less of it a mesh lets through, in the model as in another solver: that is as if
a thin skin lay on the fruit. Sound fruit by another solver (fem.mismatch.selection.null_reference) each
seem to have such amounts of effects, alike over sizes, shapes and moduli. They are part of the plain
model, with their mean and spread over those fruit: what goes beyond them is a finding, and no parameter is
known better than to that spread. (Calibrated on the same fruit as the bank: the bank's p-values are that
much too small for others.)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from fem.mismatch.effect import Effect, Signature
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import Regressor

DISCREPANCY: Mapping[str, tuple[float, float]] = {
    "skin": (0.42, 0.09),  # mm, membrane stiffness over E
    "poisson_ratio": (0.03, 0.015),
    "gripper_compliance": (0.001, 0.0007),  # 1/mm, mm/N times E over softness
    "sensor_gain": (0.0, 0.002),
    "sensor_drift": (0.0, 0.003),  # N/s
}
"""Mean and standard deviation of the amount of an effect's signature, of each pad's where it has one. Of the
bank's fruit: skin alone first, Poisson's ratio and the jaws with that in place (`benchmarks/mismatch_nulls.py
--without`); gains and drifts as root mean squares."""
SCALES_WITH_COMPLIANCE = ("gripper_compliance",)
"""Of these the amount grows as the flesh gives way: times 1/E and Ground.softness."""
SATURATING = ("skin",)
"""Responses that level off as their parameter grows: beside a true one the seeming amount would be much less.
Their own refit goes without it, and the whole of it counts as error of the parameter."""


def discrepancy_columns(
    forward: ForwardModel,
    found: Iterable[tuple[Effect, Signature]],
    discrepancy: Mapping[str, tuple[float, float]] = DISCREPANCY,
) -> list[Regressor]:
    """Columns of the effects in `discrepancy`, one for each alternative of theirs.

    What pads feel in the air is no error of the model, and not among it.
    """
    columns = []
    for effect, signature in found:
        if effect.name not in discrepancy:
            continue
        mean, sd = discrepancy[effect.name]
        size = forward.compliance * forward.compliance_ratio if effect.name in SCALES_WITH_COMPLIANCE else 1.0
        (column,) = signature.columns
        fields = [None if field is None else replace(field, rest=None) for field in column.fields]
        name = f"as if {effect.name}"
        columns.append(
            replace(column, name=name, mean=mean * size, sd=sd * size, positive=False, fields=fields)
        )
    return columns


def beside(effects: Iterable[Effect], columns: Sequence[Regressor], chosen: Sequence[int]) -> tuple[int, ...]:
    """Of the chosen columns those that stand beside these effects' own refits."""
    left_out = {f"as if {effect.name}" for effect in effects if effect.name in SATURATING}
    return tuple(j for j in chosen if columns[j].name not in left_out)


def discrepancy_spread(effect: Effect) -> float:
    """What BEND_OVER adds to the standard deviation of an effect's parameter."""
    return float(np.hypot(*DISCREPANCY[effect.name])) if effect.name in SATURATING else 0.0

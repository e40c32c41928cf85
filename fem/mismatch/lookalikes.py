"""What the model's own error looks like: a little of some effects, seen in every sound recording.

The finer a pattern is, the less of it a mesh lets through, in the model as in another solver: that is as if
a thin skin lay on the fruit. Of 17 sound fruit by another solver (fem.mismatch.null_bank) each
seems to have such amounts of effects. They are part of the plain model, with their mean and spread over
those fruit: what goes beyond them is a finding, and no parameter is known better than to that spread.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from fem.mismatch.effect import Effect, Signature
from fem.mismatch.fields import Column
from fem.mismatch.ground import Ground

SEEMING: Mapping[str, tuple[float, float]] = {
    "skin": (0.42, 0.09),
    "poisson_ratio": (0.03, 0.015),
    "gripper_compliance": (0.001, 0.0007),
    "sensor_gain": (0.0, 0.002),
    "sensor_drift": (0.0, 0.003),
}
"""Mean and standard deviation of the amount of an effect's signature, of each pad's where it has one."""
AS_FLESH_GIVES_WAY = ("gripper_compliance",)
"""Of these the amount grows as the flesh gives way: times 1/E and Ground.softness."""
BEND_OVER = ("skin",)
"""Responses that level off as their parameter grows: beside a true one the seeming amount would be much less.
Their own refit goes without it, and the whole of it counts as error of the parameter."""


def lookalikes(ground: Ground, found: Iterable[tuple[Effect, Signature]]) -> list[Column]:
    """Columns of the effects in SEEMING, one for each alternative of theirs."""
    columns = []
    for effect, signature in found:
        if effect.name not in SEEMING:
            continue
        mean, sd = SEEMING[effect.name]
        size = ground.compliance * ground.softness if effect.name in AS_FLESH_GIVES_WAY else 1.0
        (column,) = signature.columns
        name = f"as if {effect.name}"
        columns.append(replace(column, name=name, mean=mean * size, sd=sd * size, positive=False))
    return columns


def beside(effects: Iterable[Effect], columns: Sequence[Column], chosen: Sequence[int]) -> tuple[int, ...]:
    """Of the chosen columns those that stand beside these effects' own refits."""
    left_out = {f"as if {effect.name}" for effect in effects if effect.name in BEND_OVER}
    return tuple(j for j in chosen if columns[j].name not in left_out)


def seeming_spread(effect: Effect) -> float:
    """What BEND_OVER adds to the standard deviation of an effect's parameter."""
    return float(np.hypot(*SEEMING[effect.name])) if effect.name in BEND_OVER else 0.0

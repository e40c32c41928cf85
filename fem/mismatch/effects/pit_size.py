"""`pit_size`: the pit differs from the category's in size, by the factor `scale` in every direction."""

import numpy as np

from fem.estimation.sensitivity import PIT_SIZE
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.pit_change import PitChange

SPEC = EffectSpec(
    name="pit_size",
    rank=90,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit is larger or smaller than expected",
        meaning="The pit's size differs from the category's by more than usual.",
        advice="Apply the effect for this fruit. Where a cultivar always shows it, give the batch a pit "
        "prior of its own.",
    ),
    parameters=(
        EffectParameter(
            "scale", "1", "size of the pit over the expected", limits=(0.01, 100.0), low=0.5, high=1.5
        ),
    ),
    correction=Correction.PIT_SIZE,
    of_the_pit=True,
)
"""Limits and bounds are set by hand, wide."""


EFFECT: Effect = PitChange(
    spec=SPEC,
    causes=(PIT_SIZE,),
    sd=0.2,
    value=lambda amount: float(np.exp(amount)),
    amount=lambda scale: float(np.log(scale)),
)
"""The prior of 0.2 is set by hand: a pit that is a fifth too large."""

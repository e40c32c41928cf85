"""`pit_offset`: the pit is off the category's place by `offset_mm` (true centre minus the prior's)."""

from fem.estimation.sensitivity import PIT_OFFSET
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.pit_change import PitChange

SPEC = EffectSpec(
    name="pit_offset",
    rank=80,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit does not sit where it is expected",
        meaning="The pit is off its usual place, so that the flesh is thinner on one side.",
        advice="Apply the effect for this fruit. Where many fruit of a lot show it, change the pit prior.",
    ),
    parameters=(
        EffectParameter(
            "offset_mm",
            "mm",
            "where the pit is, less where it is expected",
            components=3,
            limits=(-100.0, 100.0),
            low=-6.0,
            high=6.0,
        ),
    ),
    correction=Correction.PIT_OFFSET,
    of_the_pit=True,
)
"""Limits and bounds are set by hand, wide."""


EFFECT: Effect = PitChange(spec=SPEC, causes=PIT_OFFSET, sd=2.0)
"""The prior of 2 mm is set by hand: a pit far off its usual place."""

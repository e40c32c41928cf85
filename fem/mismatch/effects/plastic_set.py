"""`plastic_set`: flesh yields where it is strained most, and keeps its new shape.

The law is fem.materials.von_mises_set. Signatures: one for each of a few Y. The amount is 1 to 3, since
yielded flesh transfers load to its neighbours.
"""

from fem.materials.strain_path import deviator, von_mises
from fem.materials.von_mises_set import von_mises_set
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.path_law import PathLawEffect

SPEC = EffectSpec(
    name="plastic_set",
    rank=120,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the grasp itself leaves a lasting dent",
        meaning="The flesh does not spring back: it was pressed beyond what it bears.",
        advice="Lower the gripper's force for this lot; the fruit grasped so far may show bruises.",
    ),
    parameters=(
        EffectParameter(
            "yield_over_E",
            "1",
            "stress at which a dent stays, over E",
            limits=(0.0, 1e3),
            low=1e-3,
            high=0.5,
            log=True,
            strain_power=1.0,
        ),
    ),
    remembers_grasps=True,
)
"""Limits and bounds are set by hand, wide."""

EFFECT: Effect = PathLawEffect(
    spec=SPEC,
    law=lambda values, nu: von_mises_set(values["yield_over_E"], poisson_ratio=nu),
    seen=lambda gradient, nu: von_mises(deviator(gradient), poisson_ratio=nu),
    symbol="Y",
    relative=(0.5, 0.7, 0.85),
    exceeding=0.002,
    unit_law=lambda level, nu: von_mises_set(level, poisson_ratio=nu),
    name="set",
    sd=1.5,
    frames=48,
)
"""Set by hand: `exceeding` is the share of the flesh that yields first."""

"""`damage`: flesh softens permanently where its strain energy was once large (Mullins).

The law is fem.materials.mullins_damage. Signatures: one for each of a few W0; the amount is dmax to first
order. Damaged flesh strains more, so that dmax is less than the amount x: x / (1 + x).
"""

from fem.materials.mullins_damage import mullins_damage
from fem.materials.strain_path import strain_energy
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.path_law import PathLawEffect

SPEC = EffectSpec(
    name="damage",
    rank=130,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh is softer the second time it is pressed",
        meaning="The first squeeze breaks some of the flesh's structure, so that later ones meet less "
        "resistance.",
        advice="Use the first squeeze of every fruit only, lower the force, and do not grasp a place twice.",
    ),
    parameters=(
        EffectParameter(
            "dmax",
            "1",
            "most of the resistance that is lost",
            limits=(0.0, 1.0),
            low=0.02,
            high=0.95,
        ),
        EffectParameter(
            "W0_over_E",
            "1",
            "energy at which it is lost, over E",
            limits=(0.0, 1e6),
            low=1e-6,
            high=1.0,
            log=True,
            strain_power=2.0,
        ),
    ),
    remembers_grasps=True,
)
"""Limits and bounds are set by hand, wide."""

EFFECT: Effect = PathLawEffect(
    spec=SPEC,
    law=lambda values, nu: mullins_damage(values["dmax"], values["W0_over_E"], poisson_ratio=nu),
    seen=lambda gradient, nu: strain_energy(gradient, poisson_ratio=nu),
    symbol="W0",
    relative=(0.1, 0.4, 1.6),
    exceeding=0.05,
    unit_law=lambda level, nu: mullins_damage(1.0, level, poisson_ratio=nu),
    name="dmax",
    sd=0.3,
    from_amount=lambda amount: (amount / (1 + amount),),
    frames=44,
)
"""Set by hand: at 1 flesh has no stiffness, so that a dmax of a half is large. A twentieth of the flesh is
the part under the pads, which is damaged first."""

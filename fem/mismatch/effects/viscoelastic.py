"""`viscoelastic`: the flesh relaxes.  E(t) = E (1 - g + g exp(-t / tau))

The displacements follow by fem.materials.relaxing_arm:

    u(t) = s [c(t) + g / (1 - g) h(t)],      h' = (c - h) (1 - g) / tau

s = 1/E at the first instant.
"""

from fem.materials.relaxing_arm import RelaxingArm
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.fading_law import FadingLaw, lagged
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields

SPEC = EffectSpec(
    name="viscoelastic",
    rank=10,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh creeps: it gives way slowly under a steady load",
        meaning="Part of the flesh's resistance fades over time, so the same squeeze feels softer the longer "
        "it lasts. All wet flesh does this; here it is strong enough to matter.",
        advice="Compare fruit at the same speed and hold time, or apply the effect to the batch so that the "
        "modulus is the one at the first instant.",
    ),
    parameters=(
        EffectParameter(
            "g",
            "1",
            "share of the resistance that fades",
            limits=(0.0, 1.0),
            low=0.01,
            high=0.95,
            numbered=True,
        ),
        EffectParameter(
            "tau_s",
            "s",
            "time over which it fades",
            limits=(1e-6, 1e6),
            low=0.05,
            high=200.0,
            log=True,
            numbered=True,
        ),
    ),
    knows_time=True,
)
"""Limits and bounds are set by hand, wide."""


def _at_once(model: CaseModel) -> Fields:
    return model.plain


def _crept(model: CaseModel, g: float, tau_s: float) -> Fields:
    arm = RelaxingArm(g=g, tau_s=tau_s)
    return [
        arm.creep_share * lagged(recording, recording.tracks.unit_displacement, arm.retardation_s)
        for recording in model.grasps
    ]


EFFECT: Effect = FadingLaw(spec=SPEC, at_once=_at_once, response=_crept)

"""`gripper_compliance`: each jaw yields, and travels less than recorded by mm_per_N times its force.

A marker's recorded position is ahead of the true one along its pad's normal. The model is exact and linear.
"""

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.moved_markers import MovedMarkers
from fem.mismatch.model.plain_model import GraspResponse

SPEC = EffectSpec(
    name="gripper_compliance",
    rank=160,
    family="measurement",
    scope=Scope.GRIPPER,
    words=EffectWords(
        short="the gripper itself gives way under load",
        meaning="Jaws or mount bend, so that they travel less than the machine reports.",
        advice="Tighten the jaws. Apply the effect: travel is then corrected by what the jaws give way.",
    ),
    parameters=(
        EffectParameter(
            "mm_per_N",
            "mm/N",
            "how far each jaw gives way per newton",
            limits=(-10.0, 10.0),
            low=0.0,
            high=0.5,
        ),
    ),
    correction=Correction.JAW_COMPLIANCE,
)
"""Limits and bounds are set by hand, wide."""


def _ahead(recording: GraspResponse, mm_per_N: float) -> Float[np.ndarray, "f n 3"]:
    """The normal force of each marker's pad, along the pad's normal, times the jaws' compliance."""
    ahead = np.empty_like(recording.tracks.position_mm)
    for k in range(len(recording.links)):
        normal = recording.pose[k][:, :3, 2]
        force = np.einsum("fx,fx->f", recording.pad_force(k), normal)
        ahead[:, recording.pad_of_marker == k] = (mm_per_N * force[:, None] * normal)[:, None]
    return ahead


EFFECT: Effect = MovedMarkers(spec=SPEC, sd=0.03, positive=True, moved_mm=_ahead)
"""The prior of 0.03 mm/N is set by hand: jaws that bend visibly."""

"""`gripper_compliance`: the jaws give way, each travels less than recorded, by mm_per_N times its force.

A marker's recorded position lies ahead of the true one along its pad's normal. Exact and linear.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import Correction, EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.pads import pad_force
from fem.mismatch.signature_variant import ONE_WAY, Variant

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
        number(
            "mm_per_N",
            "mm/N",
            "how far each jaw gives way per newton",
            limits=(-10.0, 10.0),
            low=0.0,
            high=0.5,
            model_share=0.1,
        ),
    ),
    correction=Correction.JAW_COMPLIANCE,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class GripperCompliance:
    """One compliance for all jaws."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Each pad's force along its own normal."""
        fields = [ObservationDelta(markers=_ahead(recording)) for recording in forward.base.grasps]
        return [
            Signature(
                variant=ONE_WAY, columns=(Regressor(name="mm_per_N", sd=0.03, positive=True, fields=fields),)
            )
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the compliance."""
        return {"mm_per_N": float(np.clip(amounts[0], 0.0, 0.4))}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Positions too far ahead by the jaw's own giving way."""
        return Response(
            unit=[recording.tracks.unit_displacement for recording in forward.base.grasps],
            shift_mm=[parameters["mm_per_N"] * _ahead(recording) for recording in forward.base.grasps],
        )


def _ahead(recording: GraspResponse) -> Float[np.ndarray, "f n 3"]:
    """Normal force of each marker's pad along the pad's normal, N."""
    ahead = np.empty_like(recording.tracks.position_mm)
    for k in range(len(recording.links)):
        normal = recording.pose[k][:, :3, 2]
        force = np.einsum("fx,fx->f", pad_force(recording, k), normal)
        ahead[:, recording.pad_of_marker == k] = (force[:, None] * normal)[:, None]
    return ahead


EFFECT: Effect = GripperCompliance()

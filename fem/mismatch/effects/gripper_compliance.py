"""`gripper_compliance`: the jaws give way, each travels less than recorded, by mm_per_N times its force.

A marker's recorded position lies ahead of the true one along its pad's normal. Exact and linear.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Family, ParameterSpec, Response, Signature
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.pads import pad_force


@dataclass(frozen=True)
class GripperCompliance:
    """One compliance for all jaws."""

    name: str = "gripper_compliance"
    family: Family = "measurement"
    parameters: tuple[ParameterSpec, ...] = (
        ParameterSpec(name="mm_per_N", unit="mm/N", low=0.0, high=0.5, model_share=0.1),
    )

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Each pad's force along its own normal."""
        fields = [ObservationDelta(markers=_ahead(recording)) for recording in forward.base.grasps]
        return [
            Signature(label="", columns=(Regressor(name="mm_per_N", sd=0.03, positive=True, fields=fields),))
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the compliance."""
        return {"mm_per_N": float(np.clip(amounts[0], 0.0, 0.4))}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], choice: str) -> Response:
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


EFFECT = GripperCompliance()

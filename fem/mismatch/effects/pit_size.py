"""`pit_size`: the pit is larger or smaller than the category's, by `scale` in every direction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT_SIZE
from fem.mismatch.effect import Family, ParameterSpec, Response, Signature
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import inner_changes
from fem.mismatch.model.moved_pit_response import pit_responses
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor


@dataclass(frozen=True)
class PitSize:
    """True size over the prior's."""

    name: str = "pit_size"
    family: Family = "object"
    parameters: tuple[ParameterSpec, ...] = (ParameterSpec(name="scale", unit="1", low=0.5, high=1.5),)

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """The first order in ln scale; none for a fruit without a pit."""
        changes = [inner_changes(forward, recording) for recording in forward.base.grasps]
        if any(PIT_SIZE not in change for change in changes):
            return []
        fields = [ObservationDelta(markers=forward.compliance * change[PIT_SIZE]) for change in changes]
        return [Signature(label="", columns=(Regressor(name="ln scale", sd=0.2, fields=fields),))]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is ln scale."""
        return {"scale": float(np.exp(np.clip(amounts[0], -0.5, 0.35)))}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], choice: str) -> Response:
        """The fruit meshed with that pit."""
        pit = np.array([0.0, 0.0, 0.0, np.log(parameters["scale"])])
        return Response(unit=pit_responses(forward, self.name, pit))


EFFECT = PitSize()

"""An effect that puts the recorded markers elsewhere, by one parameter, and leaves the flesh as it is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Response, Signature
from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.signature_variant import Variant


@dataclass(frozen=True, kw_only=True)
class MovedMarkers:
    """`moved_mm`: recorded less true positions of a recording's markers (frames by markers) at a value of the
    parameter. `sd`: its prior standard deviation about zero. `step`: the value whose quotient is the slope.
    """

    spec: EffectSpec
    sd: float
    moved_mm: Callable[[GraspResponse, float], Float[np.ndarray, "f n 3"]]
    step: float = 1.0
    positive: bool = False

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """The slope at zero."""
        slopes = [self.moved_mm(recording, self.step) / self.step for recording in forward.base.grasps]
        name = self.spec.searched[0].name
        return [Signature.of_markers(name, slopes, sd=self.sd, positive=self.positive)]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the parameter."""
        return self.spec.within_bounds(*amounts)

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Positions off by that much."""
        value = parameters[self.spec.searched[0].name]
        shift_mm = [self.moved_mm(recording, value) for recording in forward.base.grasps]
        return Response.plain(forward, shift_mm=shift_mm)

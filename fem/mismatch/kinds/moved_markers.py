"""Effects that shift the recorded markers, by one parameter, and do not change the flesh."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Parameters, Response, Signature
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.signature_variant import Variant


@dataclass(frozen=True, kw_only=True)
class MovedMarkers(Effect):
    """`moved_mm`: recorded minus true positions of a recording's markers (frames by markers) at a value of
    the parameter. `sd`: its prior standard deviation about zero. `step`: step of the difference quotient.
    """

    sd: float
    moved_mm: Callable[[GraspResponse, float], Float[np.ndarray, "f n 3"]]
    step: float = 1.0
    positive: bool = False

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """The derivative at zero."""
        slopes = [self.moved_mm(recording, self.step) / self.step for recording in model.grasps]
        name = self.spec.searched[0].name
        return [Signature.of_markers(name, slopes, sd=self.sd, positive=self.positive)]

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The plain response with shifted positions."""
        value = parameters[self.spec.searched[0].name]
        shift_mm = [self.moved_mm(recording, value) for recording in model.grasps]
        return Response.plain(model, shift_mm=shift_mm)

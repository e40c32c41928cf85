"""`pit_size`: the pit is larger or smaller than the category's, by `scale` in every direction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT_SIZE
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import Correction, EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import OfInnerChange, inner_changes
from fem.mismatch.model.moved_pit_response import pit_responses
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.signature_variant import ONE_WAY, Variant

SPEC = EffectSpec(
    name="pit_size",
    rank=90,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit is larger or smaller than expected",
        meaning="The pit's size differs from the category's by more than usual.",
        advice="Apply the effect for this fruit. Where a cultivar always shows it, give the batch a pit "
        "prior of its own.",
    ),
    parameters=(
        number("scale", "1", "size of the pit over the expected", limits=(0.01, 100.0), low=0.5, high=1.5),
    ),
    correction=Correction.PIT_SIZE,
    of_the_pit=True,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class PitSize:
    """True size over the prior's."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """The first order in ln scale; none for a fruit without a pit."""
        changes = [inner_changes(forward, recording) for recording in forward.base.grasps]
        if any(PIT_SIZE not in change for change in changes):
            return []
        fields = [ObservationDelta(markers=forward.compliance * change[PIT_SIZE]) for change in changes]
        column = Regressor(name="ln scale", sd=0.2, fields=fields, of_forces=OfInnerChange(PIT_SIZE))
        return [Signature(variant=ONE_WAY, columns=(column,))]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is ln scale."""
        return {"scale": float(np.exp(np.clip(amounts[0], -0.5, 0.35)))}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The fruit meshed with that pit."""
        pit = np.array([0.0, 0.0, 0.0, np.log(parameters["scale"])])
        return Response(unit=pit_responses(forward, self.spec.name, pit))


EFFECT: Effect = PitSize()

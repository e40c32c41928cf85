"""`pit_offset`: the pit sits elsewhere than the category's, by `offset_mm` (true centre less the prior's)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT_OFFSET
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import Correction, EffectSpec, EffectWords, Scope, vector
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import OfInnerChange, inner_changes
from fem.mismatch.model.moved_pit_response import pit_responses
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.signature_variant import ONE_WAY, Variant

NAMES = ("offset_mm.0", "offset_mm.1", "offset_mm.2")

SPEC = EffectSpec(
    name="pit_offset",
    rank=80,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit does not sit where it is expected",
        meaning="The pit is off its usual place, so that the flesh is thinner on one side.",
        advice="Apply the effect for this fruit. Where many fruit of a lot show it, change the pit prior.",
    ),
    parameters=(
        vector(
            "offset_mm",
            "mm",
            "where the pit is, less where it is expected",
            components=3,
            limits=(-100.0, 100.0),
            low=-6.0,
            high=6.0,
            model_sd=0.5,
        ),
    ),
    correction=Correction.PIT_OFFSET,
    of_the_pit=True,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class PitOffset:
    """Three components, mm, fruit frame."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """The first order in x, y and z; none for a fruit without a pit."""
        changes = [inner_changes(forward, recording) for recording in forward.base.grasps]
        if any(PIT_OFFSET[0] not in change for change in changes):
            return []
        columns = tuple(
            Regressor(
                name=cause,
                sd=2.0,
                fields=[ObservationDelta(markers=forward.compliance * change[cause]) for change in changes],
                of_forces=OfInnerChange(cause),
            )
            for cause in PIT_OFFSET
        )
        return [Signature(variant=ONE_WAY, columns=columns)]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amounts are the offset."""
        return dict(zip(NAMES, np.clip(amounts, -5.0, 5.0).tolist(), strict=True))

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The fruit meshed with the pit there."""
        pit = np.array([*(parameters[name] for name in NAMES), 0.0])
        return Response(unit=pit_responses(forward, self.spec.name, pit))


EFFECT: Effect = PitOffset()

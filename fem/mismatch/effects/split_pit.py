"""`split_pit`: the pit is two rigid halves, parted along the suture, that move each for itself.

The suture plane holds the stem's axis; its angle about that axis is unknown. What the halves' motion adds to
the plain response is fem.mismatch.model.parted_pit: linear in the share m by which they part of what they
would with nothing joining them (0: a whole pit, 1: free halves). Signature: that, for a row of angles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.parted_pit import OfHalves, part_together, parted_response
from fem.mismatch.signature_variant import AtValue, Variant, value_of

ANGLE, SHARE = "angle_deg", "share"
ANGLES_DEG = (-75.0, -45.0, -15.0, 15.0, 45.0, 75.0)
"""Of the signatures, degrees: 30 apart, over which what is seen turns gently. Set by hand."""
LEAST, MOST = 0.01, 2.0
"""Bounds of the share: next to a whole pit; free halves in flesh that gives way twice as much at the suture's
edge as the mesh has it. Set by hand."""
FARTHEST_DEG = 180.0
"""An angle and the one 180 degrees on are one plane; the search may pass the ends of ANGLES_DEG by a turn."""

SPEC = EffectSpec(
    name="split_pit",
    rank=105,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit is split along its suture",
        meaning="The pit's two halves move each for itself, so that the flesh gives way more than about a "
        "whole pit, and more across the suture than along it.",
        advice="Cut the fruit and look: a split pit often comes with mould inside. Read the modulus with the "
        "split taken out.",
    ),
    parameters=(
        number(
            ANGLE,
            "deg",
            "angle of the suture plane about the stem's axis, from x towards y",
            limits=(-360.0, 360.0),
            low=-FARTHEST_DEG,
            high=FARTHEST_DEG,
            model_share=0.0,
            model_sd=5.0,
        ),
        number(
            SHARE,
            "1",
            "how far the halves part, of what they would with nothing joining them",
            limits=(0.0, 10.0),
            low=LEAST,
            high=MOST,
            model_share=0.1,
        ),
    ),
    of_the_pit=True,
)
"""By hand, wide: `limits`, `low`, `high`, `model_sd`, `model_share` until there are cases to measure."""


@dataclass(frozen=True)
class SplitPit:
    """Two halves; see the module."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Free halves, one for each angle of the suture; none for a fruit without a pit."""
        if not len(forward.base.mesh.pit_nodes):
            return []
        part_together(forward, ANGLES_DEG)
        signatures = []
        for angle in ANGLES_DEG:
            column = Regressor(
                name=SHARE,
                sd=1.0,
                positive=True,
                fields=[
                    ObservationDelta(markers=forward.compliance * more) for more in _parted(forward, angle)
                ],
                of_forces=OfHalves(forward, angle),
            )
            variant = AtValue(symbol="suture at", value=angle, unit="deg")
            signatures.append(Signature(variant=variant, columns=(column,)))
        return signatures

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the share."""
        return {
            ANGLE: value_of(signature.variant),
            SHARE: float(np.clip(amounts[0], 2 * LEAST, 0.9 * MOST)),
        }

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Exactly linear in the share."""
        return Response(
            unit=[
                recording.tracks.unit_displacement + parameters[SHARE] * more
                for recording, more in zip(
                    forward.base.grasps, _parted(forward, parameters[ANGLE]), strict=True
                )
            ]
        )


def _parted(forward: ForwardModel, angle_deg: float) -> list[Float[np.ndarray, "_f _n 3"]]:
    return forward.each(lambda recording: parted_response(forward, recording, angle_deg))


EFFECT: Effect = SplitPit()

"""`viscoelastic`: the flesh relaxes.  E(t) = E (1 - g + g exp(-t / tau))

What that makes of displacements is fem.materials.relaxing_arm:

    u(t) = s [c(t) + g / (1 - g) h(t)],      h' = (c - h) (1 - g) / tau

s = 1/E of the first instant. Signature: the same for g -> 0, for a row of tau.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.relaxing_arm import RelaxingArm, lagging
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.forward_model import ForwardModel, over_all_frames
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.signature_variant import AtValue, Variant, value_of

TAUS_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Relaxation times of the signatures, s: threefold apart, from the shortest press to beyond the hold. Set by
hand."""

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
        number(
            "g",
            "1",
            "share of the resistance that fades",
            limits=(0.0, 1.0),
            low=0.01,
            high=0.95,
            model_share=0.03,
            numbered=True,
        ),
        number(
            "tau_s",
            "s",
            "time over which it fades",
            limits=(1e-6, 1e6),
            low=0.05,
            high=200.0,
            log=True,
            model_share=0.05,
            numbered=True,
        ),
    ),
    knows_time=True,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class Viscoelastic:
    """One relaxing arm."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """g / (1 - g) h, one for each tau."""
        return [
            Signature(
                variant=AtValue(symbol="tau", value=tau, unit="s"),
                columns=(
                    Regressor(
                        name=f"g, tau {tau:g} s",
                        sd=0.5,
                        positive=True,
                        fields=[
                            ObservationDelta(markers=forward.compliance * crept)
                            for crept in _crept(forward, tau)
                        ],
                    ),
                ),
            )
            for tau in TAUS_S
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """From the retarded share and time to those of relaxation."""
        arm = RelaxingArm.of_creep(float(np.clip(amounts[0], 0.02, 5.0)), value_of(signature.variant))
        return {"g": arm.g, "tau_s": arm.tau_s}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Exact for force histories that run straight between frames."""
        arm = RelaxingArm(g=parameters["g"], tau_s=parameters["tau_s"])
        crept = _crept(forward, arm.retardation_s)
        grasps = forward.base.grasps
        return Response(
            unit=[
                recording.tracks.unit_displacement + arm.creep_share * creep
                for recording, creep in zip(grasps, crept, strict=True)
            ]
        )


def _crept(forward: ForwardModel, retardation_s: float) -> list[Float[np.ndarray, "_f _n 3"]]:
    """h: nothing at once, in time all of c."""
    responses = []
    for recording in forward.base.grasps:
        whole = over_all_frames(recording, recording.tracks.unit_displacement)
        responses.append(lagging(whole, recording.case.history.time_s, retardation_s)[recording.used])
    return responses


EFFECT: Effect = Viscoelastic()

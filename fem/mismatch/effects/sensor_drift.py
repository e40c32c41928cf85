"""`sensor_drift`: the normal force that one pad records grows by newton_per_s, whether it touches or not.

Counted from the frames in the air in which the pad's offset was taken, evenly over its markers. The true
force is the recorded one less the drift. What shows it best is the pad after it has let go (fem.mismatch.
resting_force).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import PAD, Correction, EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor, wrench
from fem.mismatch.model.pads import own_markers, pads_of, response_to
from fem.mismatch.signature_variant import OfPad, Variant, pad_of

SPEC = EffectSpec(
    name="sensor_drift",
    rank=150,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="the force reading of one pad drifts with time",
        meaning="The pad's reading creeps although the load is steady: a warming gel, a tired membrane.",
        advice="Let the sensor warm up, zero it before every grasp, and apply the effect to the recordings "
        "made so far.",
    ),
    parameters=(
        PAD,
        number(
            "newton_per_s",
            "N/s",
            "growth of the reading per second",
            limits=(-1e3, 1e3),
            low=-3.0,
            high=3.0,
            model_share=0.01,
        ),
    ),
    correction=Correction.FORCE_DRIFT,
    knows_time=True,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class SensorDrift:
    """One pad's drift; which pad is the signature's variant."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """Minus the response to a growing pressure, and the imbalance that it brings."""
        signatures = []
        for pad in pads_of(forward):
            fields = [
                ObservationDelta(
                    markers=-forward.compliance * alone, balance=balance, rest=_at_rest(recording, pad)
                )
                for recording, (alone, balance) in zip(
                    forward.base.grasps, _of_pad(forward, pad), strict=True
                )
            ]
            columns = (Regressor(name=f"{pad} newton_per_s", sd=0.1, fields=fields),)
            signatures.append(Signature(variant=OfPad(pad=pad), columns=columns))
        return signatures

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the drift."""
        return {"newton_per_s": float(np.clip(amounts[0], -2.5, 2.5))}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The forces of that pad less the drift: exact and linear."""
        rate = parameters["newton_per_s"]
        parts = _of_pad(forward, pad_of(variant))
        return Response(
            unit=[
                recording.tracks.unit_displacement - rate * alone
                for recording, (alone, _) in zip(forward.base.grasps, parts, strict=True)
            ],
            balance=[rate * balance for _, balance in parts],
            rest=[rate * _at_rest(recording, pad_of(variant)) for recording in forward.base.grasps],
        )


def _at_rest(recording: GraspResponse, pad: str) -> Float[np.ndarray, " p"]:
    """Growth of each pad's force per N/s of drift: those of its markers that the fit leaves out lack."""
    growth = np.zeros(len(recording.pad_names))
    if pad in recording.pad_names:
        number = recording.pad_names.index(pad)
        growth[number] = own_markers(recording, number).sum() / recording.case.pads[number].markers
    return growth


def _of_pad(
    forward: ForwardModel, pad: str
) -> list[tuple[Float[np.ndarray, "_f _n 3"], Float[np.ndarray, "_f 6"]]]:
    """Response (mm MPa) and imbalance (N) per N/s of drift; zero where the pad takes no part."""
    parts = []
    for recording in forward.base.grasps:
        if pad not in recording.pad_names:
            parts.append((np.zeros_like(recording.force_N), np.zeros((len(recording.force_N), 6))))
            continue
        number = recording.pad_names.index(pad)
        history = recording.case.history
        air = [at for at, phase in zip(history.time_s, history.phase, strict=True) if phase == "air"]
        since = recording.time_s - np.mean(
            [at for at in air if at < recording.time_s[0]] or [history.time_s[0]]
        )
        normal = recording.pose[number][0, :3, 2]
        pressed = np.where(own_markers(recording, number), normal / recording.case.pads[number].markers, 0.0)
        pressed = np.broadcast_to(pressed, (1, *recording.patterns.shape[1:]))
        moved = forward.memoised(
            ("drift", recording.case.name, pad), partial(response_to, forward, recording, pressed)
        )[0]
        position = recording.tracks.position_mm
        force = since[:, None, None] * pressed
        balance = wrench(force, position, centre_mm=position.mean(axis=(0, 1)))
        parts.append((since[:, None, None] * moved, balance))
    return parts


EFFECT: Effect = SensorDrift()

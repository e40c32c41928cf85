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

from fem.mismatch.effect import Family, ParameterSpec, Response, Signature
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor, wrench
from fem.mismatch.model.pads import own_markers, pads_of, response_to


@dataclass(frozen=True)
class SensorDrift:
    """One pad's drift; which pad is the signature's label."""

    name: str = "sensor_drift"
    family: Family = "measurement"
    parameters: tuple[ParameterSpec, ...] = (
        ParameterSpec(name="newton_per_s", unit="N/s", low=-3.0, high=3.0, model_share=0.01),
    )

    def signatures(self, ground: ForwardModel) -> Sequence[Signature]:
        """Minus the response to a growing pressure, and the imbalance that it brings."""
        found = []
        for pad in pads_of(ground):
            fields = [
                ObservationDelta(
                    markers=-ground.compliance * alone, balance=balance, rest=_at_rest(seen, pad)
                )
                for seen, (alone, balance) in zip(ground.base.grasps, _of_pad(ground, pad), strict=True)
            ]
            columns = (Regressor(name=f"{pad} newton_per_s", sd=0.1, fields=fields),)
            found.append(Signature(label=pad, columns=columns))
        return found

    def start(
        self, ground: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount is the drift."""
        return {"newton_per_s": float(np.clip(amounts[0], -2.5, 2.5))}

    def respond(self, ground: ForwardModel, parameters: Mapping[str, float], choice: str) -> Response:
        """The forces of that pad less the drift: exact and linear."""
        rate = parameters["newton_per_s"]
        parts = _of_pad(ground, choice)
        return Response(
            unit=[
                seen.tracks.unit_displacement - rate * alone
                for seen, (alone, _) in zip(ground.base.grasps, parts, strict=True)
            ],
            balance=[rate * balance for _, balance in parts],
            rest=[rate * _at_rest(seen, choice) for seen in ground.base.grasps],
        )


def _at_rest(seen: GraspResponse, pad: str) -> Float[np.ndarray, " p"]:
    """Growth of each pad's force per N/s of drift: those of its markers that the fit leaves out lack."""
    found = np.zeros(len(seen.pad_names))
    if pad in seen.pad_names:
        number = seen.pad_names.index(pad)
        found[number] = own_markers(seen, number).sum() / seen.case.pads[number].markers
    return found


def _of_pad(
    ground: ForwardModel, pad: str
) -> list[tuple[Float[np.ndarray, "f n 3"], Float[np.ndarray, "f 6"]]]:
    """Response (mm MPa) and imbalance (N) per N/s of drift; zero where the pad takes no part."""
    found = []
    for seen in ground.base.grasps:
        if pad not in seen.pad_names:
            found.append((np.zeros_like(seen.force_N), np.zeros((len(seen.force_N), 6))))
            continue
        number = seen.pad_names.index(pad)
        history = seen.case.history
        air = [at for at, phase in zip(history.time_s, history.phase, strict=True) if phase == "air"]
        since = seen.time_s - np.mean([at for at in air if at < seen.time_s[0]] or [history.time_s[0]])
        normal = seen.pose[number][0, :3, 2]
        pressed = np.where(own_markers(seen, number), normal / seen.case.pads[number].markers, 0.0)
        pressed = np.broadcast_to(pressed, (1, *seen.patterns.shape[1:]))
        moved = ground.kept(("drift", seen.case.name, pad), partial(response_to, ground, seen, pressed))[0]
        position = seen.tracks.position_mm
        force = since[:, None, None] * pressed
        balance = wrench(force, position, centre_mm=position.mean(axis=(0, 1)))
        found.append((since[:, None, None] * moved, balance))
    return found


EFFECT = SensorDrift()

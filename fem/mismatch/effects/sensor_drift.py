"""`sensor_drift`: the normal force that one pad records grows by newton_per_s, whether it touches or not.

The drift starts in the no-contact frames that gave the pad's offset, and is uniform over its markers. The
true force is the recorded one minus the drift. The pad's force after release shows it best
(fem.estimation.zero_drift).
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Parameters, Response, Signature
from fem.mismatch.effect_spec import PAD, Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.signature_variant import Variant, of_pad

RATE = "newton_per_s"
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
        EffectParameter(
            RATE,
            "N/s",
            "growth of the reading per second",
            limits=(-1e3, 1e3),
            low=-3.0,
            high=3.0,
        ),
    ),
    correction=Correction.FORCE_DRIFT,
    knows_time=True,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


class SensorDrift(Effect):
    """One pad's drift; which pad is the signature's variant."""

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """The response to a drift of 1 N/s, for each pad."""
        signatures = []
        for pad in model.pads:
            response = self.respond(model, {RATE: 1.0}, of_pad(pad))
            column = response.column(model, f"{pad} {RATE}", sd=0.1)
            signatures.append(Signature(variant=of_pad(pad), columns=(column,)))
        return signatures

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The response to that pad's forces minus the drift: exact and linear."""
        rate, parts = parameters[RATE], _per_drift(model, variant.pad)
        return Response.plain(
            model,
            [-rate * alone for alone, _, _ in parts],
            balance=[rate * balance for _, balance, _ in parts],
            rest=[rate * rest for _, _, rest in parts],
        )


def _per_drift(
    model: CaseModel, pad: str
) -> list[tuple[Float[np.ndarray, "_f _n 3"], Float[np.ndarray, "_f 6"], Float[np.ndarray, " _p"]]]:
    """For each recording: response (mm MPa), imbalance (N) and growth of each pad's force, per N/s of this
    pad's drift. The growth excludes markers that the fit leaves out.
    """
    parts = []
    for recording in model.grasps:
        history = recording.case.history
        air = [at for at, phase in zip(history.time_s, history.phase, strict=True) if phase == "air"]
        before = [at for at in air if at < recording.time_s[0]] or [history.time_s[0]]
        since = (recording.time_s - np.mean(before))[:, None, None]
        pressed = np.zeros_like(recording.patterns[:1])
        for k, motion in enumerate(recording.case.pads):
            if motion.name == pad:
                normal = recording.pose[k][0, :3, 2]
                pressed += np.where(recording.own_markers(k), normal / motion.markers, 0.0)
        moved = model.memoised(("drift", recording.case.name, pad), partial(recording.response_to, pressed))
        balance = recording.wrench(since * pressed)
        rest = [
            recording.own_markers(k).sum() / motion.markers if motion.name == pad else 0.0
            for k, motion in enumerate(recording.case.pads)
        ]
        parts.append((since * moved[0], balance, np.array(rest)))
    return parts


EFFECT: Effect = SensorDrift(spec=SPEC)

"""`clock_lag`: displacement and force lag behind pose and aperture by lag_s.

y_recorded(t) = pose(t) (rest + d(t - lag)), true is pose(t - lag) (rest + d(t - lag)): every marker of a pad
is off by the pad's motion during the lag. Poses are interpolated linearly between frames.
"""

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.moved_markers import MovedMarkers
from fem.mismatch.model.plain_model import GraspResponse

STEP_S = 0.05
"""Step of the difference quotient: about a frame, which smooths the linear interpolation of poses. Set by
hand."""

SPEC = EffectSpec(
    name="clock_lag",
    rank=170,
    family="measurement",
    scope=Scope.SENSOR,
    words=EffectWords(
        short="the sensor's clock and the gripper's are apart",
        meaning="Gel frames and jaw positions were stamped by clocks that differ by a fraction of a second.",
        advice="Synchronise the clocks in the recorder. Apply the effect to the recordings made so far.",
    ),
    parameters=(
        EffectParameter(
            "lag_s",
            "s",
            "how late force and displacement are against the jaws",
            limits=(-100.0, 100.0),
            low=-1.0,
            high=1.0,
        ),
    ),
    correction=Correction.CLOCK_LAG,
    knows_time=True,
    of_readings=True,
)
"""Limits and bounds are set by hand, wide."""


def _gone(recording: GraspResponse, lag_s: float) -> Float[np.ndarray, "f n 3"]:
    """Displacement of each marker's pad during the last lag_s."""
    gone = np.empty_like(recording.tracks.position_mm)
    time = recording.case.history.time_s
    for k, pad in enumerate(recording.case.pads):
        way = pad.pose[:, :3, 3]
        before = np.stack([np.interp(recording.time_s - lag_s, time, way[:, i]) for i in range(3)], axis=1)
        gone[:, recording.pad_of_marker == k] = (way[recording.used] - before)[:, None]
    return gone


EFFECT: Effect = MovedMarkers(spec=SPEC, sd=0.15, step=STEP_S, moved_mm=_gone)
"""The prior of 0.15 s is set by hand: a few frames."""

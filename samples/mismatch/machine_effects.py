"""What a faulty machine makes of a true recording: gain, drift, give, a late clock, a wrong pose.

All take the truth and return what would be recorded but for the sensor's noise. Definitions: the table of
effects in the format of mismatch cases.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from samples.mismatch.true_recording import PAD_NAMES, PadTruth, TrueRecording


def with_gain(truth: TrueRecording, *, pad: str, gain: float) -> TrueRecording:
    """Recorded force of one pad is `gain` times the true one."""
    return _changed(truth, pad, lambda p: replace(p, force_N=gain * p.force_N))


def with_drift(truth: TrueRecording, *, pad: str, newton_per_s: float) -> TrueRecording:
    """One pad's recorded normal force grows steadily from the first frame, evenly over its markers."""
    growth = newton_per_s * (truth.time_s - truth.time_s[0]) / len(truth.rest_mm)
    return _with_normal_force(truth, pad, growth)


def _with_normal_force(truth: TrueRecording, pad: str, growth: Float[np.ndarray, " t"]) -> TrueRecording:
    def drifted(p: PadTruth) -> PadTruth:
        force = p.force_N.copy()
        force[:, :, 2] += growth[:, None]
        return replace(p, force_N=force)

    return _changed(truth, pad, drifted)


def with_gripper_compliance(truth: TrueRecording, *, mm_per_N: float) -> TrueRecording:
    """Recorded travel of each jaw exceeds the true one by `mm_per_N` times the pad's normal force."""
    pads, closed = [], np.zeros(len(truth.time_s))
    for p in truth.pads:
        excess = mm_per_N * p.force_N.sum(axis=1)[:, 2]
        pose = p.pose.copy()
        pose[:, :3, 3] += excess[:, None] * pose[:, :3, 2]
        closed += excess
        pads.append(replace(p, pose=pose))
    return replace(truth, pads=(pads[0], pads[1]), aperture_mm=truth.aperture_mm - closed)


def with_pose_error(
    truth: TrueRecording, *, pad: str, shift_mm: tuple[float, float], tilt_deg: float
) -> TrueRecording:
    """Recorded pose of one pad = true pose times a shift in the gel's plane and a tilt about its x axis."""
    angle = np.radians(tilt_deg)
    error = np.eye(4)
    error[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    error[:2, 3] = shift_mm
    return _changed(truth, pad, lambda p: replace(p, pose=p.pose @ error))


def with_clock_lag(truth: TrueRecording, *, earlier: TrueRecording) -> TrueRecording:
    """Markers late against pose and aperture: `earlier` is the same grasp at the times less the lag."""
    pads = [
        replace(now, displacement_mm=then.displacement_mm, force_N=then.force_N)
        for now, then in zip(truth.pads, earlier.pads, strict=True)
    ]
    return replace(truth, pads=(pads[0], pads[1]))


def _changed(truth: TrueRecording, pad: str, change: Callable[[PadTruth], PadTruth]) -> TrueRecording:
    pads = [change(p) if name == pad else p for name, p in zip(PAD_NAMES, truth.pads, strict=True)]
    return replace(truth, pads=(pads[0], pads[1]))

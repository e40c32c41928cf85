"""A grasp with more instants than frames, so that a late clock can be read from what really happened."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from samples.grasp_plan import Motion, PlannedGrasp
from samples.mismatch.machine_effects import with_clock_lag
from samples.mismatch.true_recording import PadTruth, TrueRecording


def with_instants(grasp: PlannedGrasp, times_s: Float[np.ndarray, " k"]) -> PlannedGrasp:
    """The same grasp with corners at `times_s` too, every corner recorded."""
    motion = grasp.motion
    time = np.unique(np.round(np.concatenate([motion.time_s, times_s]), 9))
    first, last = np.round(motion.time_s[[0, -1]], 9)
    time = time[(time >= first) & (time <= last)]
    more = Motion(
        time_s=time,
        travel_mm=np.round(np.interp(time, motion.time_s, motion.travel_mm), 9),
        shear_mm=np.round(np.interp(time, motion.time_s, motion.shear_mm), 9),
        recorded=np.ones(len(time), dtype=bool),
    )
    return replace(grasp, motion=more)


def recorded_late(
    everything: TrueRecording, frames_s: Float[np.ndarray, " t"], *, lag_s: float
) -> TrueRecording:
    """Frames at `frames_s` with the markers of `lag_s` earlier; before the start, those of the start."""
    return with_clock_lag(at_times(everything, frames_s), earlier=at_times(everything, frames_s - lag_s))


def at_times(everything: TrueRecording, times_s: Float[np.ndarray, " t"]) -> TrueRecording:
    """The instants nearest to the given times."""
    index = np.abs(times_s[:, None] - everything.time_s).argmin(axis=1)
    pads = [
        PadTruth(pose=p.pose[index], displacement_mm=p.displacement_mm[index], force_N=p.force_N[index])
        for p in everything.pads
    ]
    return replace(
        everything, time_s=everything.time_s[index], aperture_mm=everything.aperture_mm[index],
        pads=(pads[0], pads[1]),
    )  # fmt: skip

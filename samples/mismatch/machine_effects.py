"""Faults of machines and gels in a recording.

A machine: gain, drift, compliance, a late clock, a wrong pose. Gels of both pads: nonlinear reading, creep,
hysteresis, warming. All take the truth and return the recording without the sensor's noise. The table of
effects in docs/formats.md defines them.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from samples.grasp_plan import Motion, PlannedGrasp
from samples.mismatch.true_recording import PadTruth, TrueRecording

NO_FORCE_N = 1e-9
"""Forces below this count as zero."""


def with_gain(truth: TrueRecording, *, pad: str, gain: float) -> TrueRecording:
    """One pad's recorded force is `gain` times the true one."""
    return _scaled(truth, lambda _: gain, only=pad)


def _scaled(
    truth: TrueRecording,
    factor: Callable[[PadTruth], Float[np.ndarray, "t ..."] | float],
    only: str | None = None,
) -> TrueRecording:
    """Recorded forces are the true ones times a factor for each pad."""
    return truth.with_pads(lambda p: replace(p, force_N=p.force_N * factor(p)), only=only)


def with_drift(truth: TrueRecording, *, pad: str, newton_per_s: float) -> TrueRecording:
    """One pad's recorded normal force grows steadily from the first frame, evenly over its markers."""
    growth_N = newton_per_s * (truth.time_s - truth.time_s[0]) / len(truth.rest_mm)
    return truth.with_pads(lambda p: _with_normal_force(p, growth_N), only=pad)


def _with_normal_force(pad: PadTruth, added_N: Float[np.ndarray, " t"]) -> PadTruth:
    """The pad with the same normal force added to every marker in a frame."""
    force = pad.force_N.copy()
    force[:, :, 2] += added_N[:, None]
    return replace(pad, force_N=force)


def with_gripper_compliance(truth: TrueRecording, *, mm_per_N: float) -> TrueRecording:
    """Recorded travel of each jaw exceeds the true one by `mm_per_N` times the pad's normal force."""

    def excess_mm(pad: PadTruth) -> Float[np.ndarray, " t"]:
        return np.asarray(mm_per_N * pad.force_N.sum(axis=1)[:, 2])

    def closer(pad: PadTruth) -> PadTruth:
        pose = pad.pose.copy()
        pose[:, :3, 3] += excess_mm(pad)[:, None] * pose[:, :3, 2]
        return replace(pad, pose=pose)

    closed_mm = sum(map(excess_mm, truth.pads))
    return replace(truth.with_pads(closer), aperture_mm=truth.aperture_mm - closed_mm)


def with_pose_error(
    truth: TrueRecording, *, pad: str, shift_mm: tuple[float, float], tilt_deg: float
) -> TrueRecording:
    """Recorded pose of one pad = true pose times a shift in the gel's plane and a tilt about its x axis."""
    angle = np.radians(tilt_deg)
    error = np.eye(4)
    error[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    error[:2, 3] = shift_mm
    return truth.with_pads(lambda p: replace(p, pose=p.pose @ error), only=pad)


def with_instants(grasp: PlannedGrasp, times_s: Float[np.ndarray, " k"]) -> PlannedGrasp:
    """The same grasp with corners at `times_s` too, every corner recorded, as input of `recorded_late`."""
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
    """Frames at `frames_s` with the markers of `lag_s` earlier; before the start, with those of the start."""
    now, earlier = (at_times(everything, times_s) for times_s in (frames_s, frames_s - lag_s))
    left, right = (
        replace(pad, displacement_mm=then.displacement_mm, force_N=then.force_N)
        for pad, then in zip(now.pads, earlier.pads, strict=True)
    )
    return replace(now, pads=(left, right))


def at_times(everything: TrueRecording, times_s: Float[np.ndarray, " t"]) -> TrueRecording:
    """The recorded instants nearest to the given times."""
    index = np.abs(times_s[:, None] - everything.time_s).argmin(axis=1)
    chosen = everything.with_pads(
        lambda p: PadTruth(
            pose=p.pose[index], displacement_mm=p.displacement_mm[index], force_N=p.force_N[index]
        )
    )
    return replace(chosen, time_s=everything.time_s[index], aperture_mm=everything.aperture_mm[index])


def with_bent_reading(truth: TrueRecording, *, a: float) -> TrueRecording:
    """Recorded force = f (1 + a |f| / M) at each marker, M the largest |f| of any marker of the recording."""

    def size(pad: PadTruth) -> Float[np.ndarray, "t n 1"]:
        return np.asarray(np.linalg.norm(pad.force_N, axis=2, keepdims=True))

    largest = max(float(size(pad).max()) for pad in truth.pads)
    return _scaled(truth, lambda p: 1 + a * size(p) / largest)


def with_gel_creep(truth: TrueRecording, *, creep: float, creep_tau_s: float) -> TrueRecording:
    """Recorded displacement = d + creep m,  m' = (d - m) / creep_tau_s, d held at each frame's value."""

    def crept(pad: PadTruth) -> PadTruth:
        memory = np.zeros_like(pad.displacement_mm)
        for k, pause_s in enumerate(np.diff(truth.time_s), start=1):
            kept = np.exp(-pause_s / creep_tau_s)
            memory[k] = kept * memory[k - 1] + (1 - kept) * pad.displacement_mm[k]
        return replace(pad, displacement_mm=pad.displacement_mm + creep * memory)

    return truth.with_pads(crept)


def with_hysteresis(truth: TrueRecording, *, share: float) -> TrueRecording:
    """Recorded force = f (1 - 4 share x (1 - x)), x the pad's normal force over its peak so far."""

    def left(pad: PadTruth) -> Float[np.ndarray, "t 1 1"]:
        total = pad.force_N.sum(axis=1)[:, 2]
        peak = np.maximum.accumulate(np.maximum(total, NO_FORCE_N))
        return np.asarray(1 - share * 4 * (total / peak) * (1 - total / peak))[:, None, None]

    return _scaled(truth, left)


def with_thermal_drift(
    truth: TrueRecording, *, strain_per_root_s: float, N_per_root_s: float
) -> TrueRecording:
    """Markers move away from the gel's middle and normal force grows, both with the square root of time."""
    root = np.sqrt(truth.time_s - truth.time_s[0])
    swell = strain_per_root_s * root[:, None, None] * (truth.rest_mm * np.array([1.0, 1.0, 0.0]))
    growth_N = N_per_root_s / len(truth.rest_mm) * root
    return truth.with_pads(
        lambda p: replace(_with_normal_force(p, growth_N), displacement_mm=p.displacement_mm + swell)
    )


def with_nominal_stiffness(truth: TrueRecording) -> TrueRecording:
    """Recorded forces are those that a sensor computes from the markers with the gel's nominal stiffness."""
    gel = truth.gel
    stiffness = np.array([gel.kt_MPa_per_mm, gel.kt_MPa_per_mm, gel.kn_MPa_per_mm])
    return truth.with_pads(
        lambda p: replace(p, force_N=-truth.marker_area_mm2 * stiffness * p.displacement_mm)
    )

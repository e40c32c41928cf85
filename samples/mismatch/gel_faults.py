"""What gels of their own fault make of a true recording: a bent reading, creep, a loop, warming.

All take the truth and return what would be recorded but for the sensor's noise; all pads are alike.
Definitions: the table of effects in the format of mismatch cases.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from samples.mismatch.true_recording import PadTruth, TrueRecording

NO_FORCE_N = 1e-9
"""A force that is none."""


def with_bent_reading(truth: TrueRecording, *, a: float) -> TrueRecording:
    """Recorded force = f (1 + a |f| / M) at each marker, M the largest |f| of any marker of the recording."""
    sizes = [np.linalg.norm(pad.force_N, axis=2, keepdims=True) for pad in truth.pads]
    largest = max(float(size.max()) for size in sizes)
    left, right = (
        replace(pad, force_N=pad.force_N * (1 + a * size / largest))
        for pad, size in zip(truth.pads, sizes, strict=True)
    )
    return replace(truth, pads=(left, right))


def with_gel_creep(truth: TrueRecording, *, creep: float, creep_tau_s: float) -> TrueRecording:
    """Recorded displacement = d + creep m,  m' = (d - m) / creep_tau_s, d held at each frame's value."""
    left, right = (
        replace(
            pad, displacement_mm=pad.displacement_mm + creep * _memory(pad, truth.time_s, tau_s=creep_tau_s)
        )
        for pad in truth.pads
    )
    return replace(truth, pads=(left, right))


def _memory(pad: PadTruth, time_s: Float[np.ndarray, " t"], *, tau_s: float) -> Float[np.ndarray, "t n 3"]:
    found = np.zeros_like(pad.displacement_mm)
    for k, pause_s in enumerate(np.diff(time_s), start=1):
        kept = np.exp(-pause_s / tau_s)
        found[k] = kept * found[k - 1] + (1 - kept) * pad.displacement_mm[k]
    return found


def with_hysteresis(truth: TrueRecording, *, share: float) -> TrueRecording:
    """While a pad's force is below its peak so far, the recorded force falls short by up to `share` of it."""
    pads = []
    for pad in truth.pads:
        total = pad.force_N.sum(axis=1)[:, 2]
        peak = np.maximum.accumulate(np.maximum(total, NO_FORCE_N))
        short = 1 - share * 4 * (total / peak) * (1 - total / peak)
        pads.append(replace(pad, force_N=pad.force_N * short[:, None, None]))
    return replace(truth, pads=(pads[0], pads[1]))


def with_thermal_drift(
    truth: TrueRecording, *, strain_per_root_s: float, N_per_root_s: float
) -> TrueRecording:
    """Markers move away from the gel's middle and each pad's normal force grows, with the root of time."""
    root = np.sqrt(truth.time_s - truth.time_s[0])
    swell = strain_per_root_s * root[:, None, None] * (truth.rest_mm * np.array([1.0, 1.0, 0.0]))
    pads = []
    for pad in truth.pads:
        force = pad.force_N.copy()
        force[..., 2] += N_per_root_s / len(truth.rest_mm) * root[:, None]
        pads.append(replace(pad, displacement_mm=pad.displacement_mm + swell, force_N=force))
    return replace(truth, pads=(pads[0], pads[1]))

"""Predictive checks: numbers of each recording, predicted from the other recordings.

Curvature of the approach with load, creep in the hold, work lost in the cycle: none of them is minimised by
the fit (Gelman et al. 2013, Bayesian Data Analysis, chapter 6). The standard deviation is that of the
markers' noise at the parameters found; what the parameters are off by is not drawn.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from fem.estimation.coloured_noise import drawn_coloured_noise
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.result import Check, GraspTrace

COPIES = 100
"""Noisy copies of a trace from which a check's standard deviation is taken."""
UNITS = {"approach at half the load": "1", "creep in the hold": "mm", "loop area": "N mm"}


def checks(
    traces: Sequence[GraspTrace], grasps: Sequence[GraspResponse], *, rng: np.random.Generator
) -> tuple[Check, ...]:
    """Each number measured, and predicted by both models; sd from the markers' noise."""
    all_checks = []
    for trace, recording in zip(traces, grasps, strict=True):
        lag1 = float(recording.tracks.lag1.mean())
        drawn = drawn_coloured_noise((COPIES, len(trace.time_s), 1, 3), lag1, rng)[:, :, 0, 0]
        noise = _noise_mm(recording) * drawn
        copies = [_numbers(trace, trace.after_mm + draw) for draw in noise]
        numbers = [_numbers(trace, x) for x in (trace.given_mm, trace.before_mm, trace.after_mm)]
        all_checks += compared(numbers, copies, UNITS, prefix=f"{trace.grasp}: ")
    return tuple(all_checks)


def compared(
    numbers: Sequence[Mapping[str, float]],
    copies: Sequence[Mapping[str, float]],
    units: Mapping[str, str],
    *,
    prefix: str = "",
    suffix: str = "",
) -> list[Check]:
    """Numbers measured, and by the models before and after; sd from noisy `copies` of the last."""
    measured, before, after = numbers
    return [
        Check(
            name=f"{prefix}{name}{suffix}",
            measured=measured[name],
            before=before[name],
            after=after[name],
            sd=float(np.std([copy[name] for copy in copies])),
            unit=units[name],
        )
        for name in measured
    ]


def _noise_mm(recording: GraspResponse) -> Float[np.ndarray, " f"]:
    """Of the mean of the markers in contact, frame by frame."""
    tracks = recording.tracks
    sd = float(tracks.sd_mm.mean())
    return np.asarray(sd / np.sqrt(np.maximum((tracks.episode >= 0).sum(axis=1), 1)))


def _numbers(trace: GraspTrace, approach_mm: Float[np.ndarray, " f"]) -> dict[str, float]:
    """Of the first loading and of the first hold; those that the recording has."""
    phase, force = np.array(trace.phase), trace.force_N
    loading = _first_run(phase == "load")
    curve_numbers = {}
    if len(loading) > 2:
        top, start = loading[-1], loading[0]
        half = loading[int(np.argmin(np.abs(force[loading] - (force[top] + force[start]) / 2)))]
        rise = approach_mm[top] - approach_mm[start]
        curve_numbers["approach at half the load"] = float((approach_mm[half] - approach_mm[start]) / rise)
    hold = _first_run(phase == "hold")
    if len(hold) > 1:
        curve_numbers["creep in the hold"] = float(approach_mm[hold[-1]] - approach_mm[hold[0]])
    if (phase == "unload").any():
        curve_numbers["loop area"] = float(np.trapezoid(force, approach_mm))
    return curve_numbers


def _first_run(chosen: np.ndarray) -> np.ndarray:
    """The first unbroken run of frames."""
    frames = np.flatnonzero(chosen)
    return frames[: int(np.argmax(np.r_[np.diff(frames) > 1, True])) + 1] if len(frames) else frames

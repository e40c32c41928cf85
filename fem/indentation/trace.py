"""A bare indenter's recording: force over travel and time, validated."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from fem.indentation.contact_curve import Geometry, out_of_range

#: least number of frames for a fit with a dozen unknowns
FEWEST_FRAMES = 20
DRIFT_SHARE_PER_MIN, RANGE_OVER_PEAK = 1.2e-4, 10.0
"""Standard deviation of the drift of a load cell, as a share of its range per minute, and the range over the
peak force, if nothing is stated. By OIML R 60-1, 5.5.1, a cell's reading under constant load changes by less
than 0.7 of the permissible error within 30 min; of the usual class, C with 3000 intervals, that is
0.7 * 0.7 * 1.5 / 3000 of the range. This is taken as two standard deviations, which may occur within a
minute. Assumed: the peak force is a tenth of the range or more."""
PER_FRAME = ("time_s", "force_N", "travel_mm", "rig_give_mm", "rig_sd_mm")
#: share of the largest speed below which the tool is at rest
STILL = 0.05


@dataclass(frozen=True, kw_only=True)
class IndenterTrace:
    """Force on the tool (positive in contact) and travel of the machine.

    `travel_mm` is the machine's own reading: contact may start later than travel, or before the first frame.
    `starts`: first frames of the joined recordings of one specimen, each with its own travel (`joined`); a
    single recording has one. `numbers`: their indices among all recordings of the specimen.
    If the rig's displacement was subtracted from the travel, `rig_give_mm` is that displacement, `rig_sd_mm`
    its standard deviation, with an error common to all frames. `drift_N_per_min`: standard deviation of the
    load cell's drift, if known.
    Raises FemFailure (bad-load) if arrays differ in length or have non-finite numbers, or time decreases.
    """

    time_s: Float[np.ndarray, " t"]
    force_N: Float[np.ndarray, " t"]
    travel_mm: Float[np.ndarray, " t"]
    geometry: Geometry
    starts: tuple[int, ...] = (0,)
    numbers: tuple[int, ...] = (0,)
    rig_give_mm: Float[np.ndarray, " t"] | None = None
    rig_sd_mm: Float[np.ndarray, " t"] | None = None
    drift_N_per_min: float | None = None

    def __post_init__(self) -> None:
        frames, count = len(self.time_s), (len(self.force_N), len(self.travel_mm))
        if count != (frames, frames):
            raise out_of_range(
                f"{frames} times, {count[0]} forces and {count[1]} travels",
                "as many of each: export them from one table",
            )
        for name in ("rig_give_mm", "rig_sd_mm"):
            values = getattr(self, name)
            if values is not None and (len(values) != frames or not np.isfinite(values).all()):
                raise out_of_range(
                    f"{name} that is not one finite number a frame",
                    f"{frames}: convert the trace again with --rig",
                )
        if frames < FEWEST_FRAMES:
            raise out_of_range(f"{frames} frames", f"at least {FEWEST_FRAMES}: record longer")
        for name in ("time_s", "force_N", "travel_mm"):
            if not np.isfinite(getattr(self, name)).all():
                raise out_of_range(f"{name} that is not finite", "numbers: drop those frames")
        if (np.diff(self.time_s) <= 0).any():
            k = int(np.argmax(np.diff(self.time_s) <= 0)) + 1
            raise out_of_range(
                f"time {self.time_s[k]:g} s after {self.time_s[k - 1]:g} s",
                "strictly increasing times: sort the frames",
            )

    def cut(self, frames: slice) -> "IndenterTrace":
        """These frames of one recording as a separate curve."""
        arrays: dict[str, Any] = {
            name: values[frames] for name in PER_FRAME if (values := getattr(self, name)) is not None
        }
        return replace(self, starts=(0,), numbers=(0,), **arrays)

    @cached_property
    def parts(self) -> tuple["IndenterTrace", ...]:
        """Each recording separately."""
        return (self,) if len(self.starts) == 1 else tuple(self.cut(frames) for frames in self.slices)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Frames of each recording."""
        ends = (*self.starts[1:], len(self.time_s))
        return tuple(slice(start, end) for start, end in zip(self.starts, ends, strict=True))

    @property
    def drift_sd_N_per_min(self) -> float:
        """The stated one, or that of a load cell of the usual class (DRIFT_SHARE_PER_MIN)."""
        if self.drift_N_per_min is not None:
            return self.drift_N_per_min
        return DRIFT_SHARE_PER_MIN * RANGE_OVER_PEAK * float(np.abs(self.force_N).max())

    @property
    def deepest(self) -> int:
        """The first frame of one recording within a thousandth of the largest depth."""
        return int(np.argmax(self.travel_mm >= self.travel_mm.max() * (1 - 1e-3)))

    @property
    def phases(self) -> tuple[str, ...]:
        """Per frame "load" (driven in), "hold" (at rest) or "unload" (drawn back).

        The speed is that between the readings before and after all equal readings about a frame, since a
        coarse travel repeats its readings while the tool moves.
        """
        if len(self.starts) > 1:
            return tuple(phase for part in self.parts for phase in part.phases)
        first = np.flatnonzero(np.r_[True, np.diff(self.travel_mm) != 0])
        equal = np.diff(np.r_[first, len(self.time_s)])
        before = np.repeat(np.maximum(first - 1, 0), equal)
        after = np.repeat(np.minimum(first + equal, len(self.time_s) - 1), equal)
        rate = (
            np.diff(self.travel_mm[[before, after]], axis=0)[0]
            / np.diff(self.time_s[[before, after]], axis=0)[0]
        )
        limit = STILL * float(np.max(np.abs(rate)))
        return tuple("load" if v > limit else "unload" if v < -limit else "hold" for v in rate)


def joined(traces: Sequence[IndenterTrace]) -> IndenterTrace:
    """Recordings of one specimen as one curve of several parts, in their order.

    Time continues from one to the next. The unknown interval between them has no influence: the law assumes
    recovered flesh at the start of each recording (`fem.indentation.contact_law`).
    """
    if len(traces) == 1:
        return traces[0]
    starts = np.cumsum([0, *(len(trace.time_s) for trace in traces)])[:-1]
    times, end = [], 0.0
    for trace in traces:
        times.append(trace.time_s - trace.time_s[0] + end)
        end = float(times[-1][-1] + np.median(np.diff(trace.time_s)))
    arrays: dict[str, Any] = {}
    for name in PER_FRAME[1:]:
        columns = [getattr(trace, name) for trace in traces]
        if any(column is not None for column in columns):  # zero for a rig that was not subtracted
            columns = [np.zeros(len(t)) if c is None else c for c, t in zip(columns, times, strict=True)]
            arrays[name] = np.concatenate(columns)
    arrays["numbers"] = tuple(range(len(traces)))
    return replace(traces[0], time_s=np.concatenate(times), starts=tuple(map(int, starts)), **arrays)


def without(trace: IndenterTrace, places: Collection[int]) -> IndenterTrace:
    """The curve without its recordings at these indices; the others keep their numbers."""
    kept = [k for k in range(len(trace.parts)) if k not in places]
    return replace(joined([trace.parts[k] for k in kept]), numbers=tuple(trace.numbers[k] for k in kept))


#: least drop of the force in a rupture, as a share of the force and in standard deviations of the noise (set
#: by hand: ten times the error of the contact theory; and above six sd, which the largest drop of white noise
#: exceeds in fewer than one of a thousand recordings of a thousand frames)
LOST, ABOVE_NOISE = 0.1, 8.0
#: least slope of the drop over the steepest rise before it. Once the ball rests, the force of a relaxing
#: solid falls at most as steeply as its unrelaxed force rose: R(0)/R(long) times the recorded rise. 4 allows
#: for a relaxation by three quarters
STEEPER = 4.0
#: share of the travel so far by which the ball may go back while the force falls (backlash; set by hand)
BACKLASH = 0.01
#: frames for which the force must stay low, since a single low reading is no rupture; and frames in which
#: the ball must not go back, since its travel may be recorded one or two frames late
STAYS, WATCHED = 3, 6


def before_rupture(trace: IndenterTrace, *, noise_N: float) -> tuple[IndenterTrace, str]:
    """One recording up to the largest force before a rupture, and a sentence about it; the whole recording
    and an empty string if there is no rupture.

    A rupture is a drop by more than LOST of the largest force so far and ABOVE_NOISE of `noise_N`, STEEPER
    than the rise before it. Afterwards the travel is not below that at the largest force. Source: ASABE
    S368.4, "Compression test of food materials of convex shape" (bioyield and rupture point: less force at
    more deformation). Raises FemFailure (bad-load) if too few frames remain.
    """
    force, time = np.asarray(median_filter(trace.force_N, size=3, mode="nearest")), trace.time_s
    top = np.maximum.accumulate(force)
    at_top = np.maximum.accumulate(np.where(force >= top, np.arange(len(force)), 0))
    lost, level = top - force, float(np.median(force[:STAYS]))
    large = (lost > LOST * np.maximum(top - level, 0.0)) & (lost > ABOVE_NOISE * noise_N)
    for k in np.flatnonzero(large[: len(force) - STAYS + 1]).tolist():
        last = int(at_top[k])
        least_mm = trace.travel_mm[last] - BACKLASH * float(np.ptp(trace.travel_mm[: last + 1]))
        stays = (lost[k : k + STAYS] > 0.5 * lost[k]).all()
        if last < STAYS or not stays or trace.travel_mm[k : k + WATCHED].min() < least_mm:
            continue
        falls = last + int(np.flatnonzero(lost[last:k] <= 0.25 * lost[k])[-1])
        steep = (force[falls] - force[k]) / (time[k] - time[falls])
        apart = max(STAYS, last // 50)  # frames over which noise does not dominate the rise
        rise = (force[apart : last + 1] - force[: last + 1 - apart]) / (
            time[apart : last + 1] - time[: last + 1 - apart]
        )
        if steep > STEEPER * rise.max(initial=0.0):
            return _cut(trace, last, before_N=float(top[k]), after_N=float(force[last : k + STAYS].min()))
    return trace, ""


def _cut(trace: IndenterTrace, last: int, *, before_N: float, after_N: float) -> tuple[IndenterTrace, str]:
    time_s, gone_mm = trace.time_s[last], trace.travel_mm[last] - trace.travel_mm[0]
    if last + 1 < FEWEST_FRAMES:
        raise out_of_range(
            f"a rupture after {last + 1} frames ({time_s:.3g} s)",
            f"at least {FEWEST_FRAMES} before it: record more often, or press slower",
        )
    said = (
        f"Rupture: at {time_s:.4g} s, {gone_mm:.3g} mm into the travel, the force falls from "
        f"{before_N:.3g} to {after_N:.3g} N though the indenter is not drawn back. What comes after is left "
        "out."
    )
    return trace.cut(slice(0, last + 1)), said

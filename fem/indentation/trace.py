"""What a bare indenter recorded: force over travel and time, checked."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from fem.indentation.contact_curve import Geometry, out_of_range

#: fewest frames that a fit with a dozen unknowns can be asked to explain
FEWEST_FRAMES = 20
DRIFT_SHARE_PER_MIN, RANGE_OVER_PEAK = 1.2e-4, 10.0
"""Standard deviation of the drift of a load cell, share of its range per minute, and the range over the peak
force where nothing is stated. By OIML R 60-1, 5.5.1, a cell's reading under constant load changes by less
than 0.7 of the permissible error within 30 min; of the usual class, C with 3000 intervals, that is
0.7 * 0.7 * 1.5 / 3000 of the range. It is taken as two standard deviations, and all of it may come within a
minute. Assumed: the peak force is a tenth of the range or more."""
PER_FRAME = ("time_s", "force_N", "travel_mm", "rig_give_mm", "rig_sd_mm")
#: travel slower than this share of the fastest counts as standing still
STILL = 0.05


@dataclass(frozen=True, kw_only=True)
class IndenterTrace:
    """Force that pushes the tool back (positive in contact) and how far the machine has driven it in.

    `travel_mm` is the machine's own reading: contact may start later than travel, or before the first frame.
    `starts`: first frames of the recordings of one specimen that are joined here, each from its own travel on
    (`joined`); one trace alone has one. `numbers`: their places among all recordings of the specimen.
    Where the rig's own give was taken off it, `rig_give_mm` is that, `rig_sd_mm` its standard deviation,
    which all frames share. `drift_N_per_min`: standard deviation of the load cell's drift, where it is known.
    Raises FemFailure (bad-load) where arrays differ in length, hold what is no number, or time runs back.
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
        """These frames of one recording, as a trace of their own."""
        arrays: dict[str, Any] = {
            name: values[frames] for name in PER_FRAME if (values := getattr(self, name)) is not None
        }
        return replace(self, starts=(0,), numbers=(0,), **arrays)

    @cached_property
    def parts(self) -> tuple["IndenterTrace", ...]:
        """Each recording by itself."""
        return (self,) if len(self.starts) == 1 else tuple(self.cut(frames) for frames in self.slices)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Frames of each recording."""
        ends = (*self.starts[1:], len(self.time_s))
        return tuple(slice(start, end) for start, end in zip(self.starts, ends, strict=True))

    @property
    def drift_sd_N_per_min(self) -> float:
        """As stated, or of a load cell of the weakest class (DRIFT_SHARE_PER_MIN)."""
        if self.drift_N_per_min is not None:
            return self.drift_N_per_min
        return DRIFT_SHARE_PER_MIN * RANGE_OVER_PEAK * float(np.abs(self.force_N).max())

    @property
    def deepest(self) -> int:
        """The first frame of one recording that is as deep as any, within a thousandth."""
        return int(np.argmax(self.travel_mm >= self.travel_mm.max() * (1 - 1e-3)))

    @property
    def phases(self) -> tuple[str, ...]:
        """Per frame "load" (driven in), "hold" (standing) or "unload" (drawn back)."""
        if len(self.starts) > 1:
            return tuple(phase for part in self.parts for phase in part.phases)
        rate = np.gradient(self.travel_mm, self.time_s)
        limit = STILL * float(np.max(np.abs(rate)))
        return tuple("load" if v > limit else "unload" if v < -limit else "hold" for v in rate)


def joined(traces: Sequence[IndenterTrace]) -> IndenterTrace:
    """Recordings of one specimen as one trace of several parts, in their order.

    Time runs on from one to the next; how long it was between them is not known and nothing asks: every
    recording is taken to meet flesh that has come back (`fem.indentation.contact_law`).
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
        if any(column is not None for column in columns):  # zero of a rig that was not taken off
            columns = [np.zeros(len(t)) if c is None else c for c, t in zip(columns, times, strict=True)]
            arrays[name] = np.concatenate(columns)
    arrays["numbers"] = tuple(range(len(traces)))
    return replace(traces[0], time_s=np.concatenate(times), starts=tuple(map(int, starts)), **arrays)


def without(trace: IndenterTrace, places: Collection[int]) -> IndenterTrace:
    """The trace less its recordings at these places; the others keep their numbers."""
    kept = [k for k in range(len(trace.parts)) if k not in places]
    return replace(joined([trace.parts[k] for k in kept]), numbers=tuple(trace.numbers[k] for k in kept))


#: share of the force that must be lost, and standard deviations of the noise beside it (set by hand: ten
#: times what the theory of the contact errs by; six of noise in one of a thousand frames is no accident)
LOST, ABOVE_NOISE = 0.1, 8.0
#: times the steepest rise before it that the fall must be as steep as: a solid that relaxes falls, once the
#: ball stands, at most as steeply as its unrelaxed force rose, which is R(0)/R(long) times the rise that is
#: seen; 4 allows for three quarters relaxed
STEEPER = 4.0
#: share of the travel so far by which the ball may come back while the force falls (backlash; set by hand)
BACKLASH = 0.01
#: frames that the force must stay down for, since one that reads low is no rupture; and over which the ball
#: must not come back, since its travel may be read one or two frames late
STAYS, WATCHED = 3, 6


def before_rupture(trace: IndenterTrace, *, noise_N: float) -> tuple[IndenterTrace, str]:
    """One recording up to the largest force before its flesh breaks, and a sentence that says so; the whole
    of it, and nothing, where no flesh breaks.

    A rupture: a fall by more than LOST of the largest force so far and ABOVE_NOISE of `noise_N`, STEEPER than
    the rise to it, after which the travel is where that force was reached or beyond. Source: ASABE S368.4,
    "Compression test of food materials of convex shape" (bioyield and rupture point: less force at more
    deformation). Raises FemFailure (bad-load) where too few frames are left.
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
        apart = max(STAYS, last // 50)  # over which noise does not rule the rise
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

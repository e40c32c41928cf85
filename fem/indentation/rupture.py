"""Flesh that breaks: where the force falls suddenly although the indenter is not drawn back."""

import numpy as np
from scipy.ndimage import median_filter

from fem.indentation.contact_curve import out_of_range
from fem.indentation.trace import FEWEST_FRAMES, IndenterTrace

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

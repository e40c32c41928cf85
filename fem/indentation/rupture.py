"""Flesh that breaks: where the force falls suddenly although the indenter is not drawn back."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
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
#: share of the frames before the fall over which the rise is taken, and the quantile that is the steepest
WINDOW, STEEPEST = 0.02, 0.9
#: frames that the force must stay down for: one that reads low is no rupture
STAYS = 3
#: frames over which the ball must not come back either: its travel may be read one or two frames late
WATCHED = 6


@dataclass(frozen=True, kw_only=True)
class Rupture:
    """`last`: the last frame before it, the one of the largest force; what was lost, where and when."""

    last: int
    before_N: float
    after_N: float
    travel_mm: float
    time_s: float

    @property
    def said(self) -> str:
        """One sentence for people."""
        return (
            f"Rupture: at {self.time_s:.4g} s, {self.travel_mm:.3g} mm into the travel, the force falls from "
            f"{self.before_N:.3g} to {self.after_N:.3g} N though the indenter is not drawn back. What comes "
            "after is left out."
        )


def find_rupture(trace: IndenterTrace, *, noise_N: float) -> Rupture | None:
    """The first sudden fall of the force during loading; None where there is none.

    A fall: more than LOST of the largest force so far and ABOVE_NOISE of `noise_N`, STEEPER than the rise to
    it, after which the travel is where that force was reached or beyond. Source: ASABE S368.4, "Compression
    test of food materials of convex shape" (bioyield and rupture point: less force at more deformation).
    """
    force = np.asarray(median_filter(trace.force_N, size=3, mode="nearest"))
    top = np.maximum.accumulate(force)
    at_top = np.maximum.accumulate(np.where(force >= top, np.arange(len(force)), 0))
    level = float(np.median(force[:3]))
    lost = top - force
    large = (lost > LOST * np.maximum(top - level, 0.0)) & (lost > ABOVE_NOISE * noise_N)
    for k in np.flatnonzero(large):
        first = int(at_top[k])
        gone = float(np.ptp(trace.travel_mm[: first + 1]))
        still = trace.travel_mm[k : k + WATCHED].min() >= trace.travel_mm[first] - BACKLASH * gone
        stays = (lost[k : k + STAYS] > 0.5 * lost[k]).all() and k + STAYS <= len(force)
        if first < STAYS or not still or not stays:
            continue
        falling = first + int(np.flatnonzero(force[first:k] >= top[k] - 0.25 * lost[k])[-1])
        steep = (force[falling] - force[k]) / (trace.time_s[k] - trace.time_s[falling])
        if steep > STEEPER * _rise_N_per_s(trace.time_s[: first + 1], force[: first + 1]):
            low = first + int(np.argmin(force[first : k + STAYS]))
            return Rupture(
                last=first,
                before_N=float(top[k]),
                after_N=float(force[low]),
                travel_mm=float(trace.travel_mm[first] - trace.travel_mm[0]),
                time_s=float(trace.time_s[first]),
            )
    return None


def before_rupture(trace: IndenterTrace, rupture: Rupture) -> IndenterTrace:
    """The trace up to the largest force; raises FemFailure (bad-load) where too few frames are left."""
    if rupture.last + 1 < FEWEST_FRAMES:
        raise out_of_range(
            f"a rupture after {rupture.last + 1} frames ({rupture.time_s:.3g} s)",
            f"at least {FEWEST_FRAMES} before it: record more often, or press slower",
        )
    return trace.cut(slice(0, rupture.last + 1))


def _rise_N_per_s(time_s: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]) -> float:
    """How steeply the force rose where it rose most, over stretches that noise does not rule."""
    apart = max(1, round(WINDOW * len(force_N)))
    slope = (force_N[apart:] - force_N[:-apart]) / (time_s[apart:] - time_s[:-apart])
    level = float(np.median(force_N[:3]))
    rising = slope[(slope > 0) & (force_N[apart:] - level > LOST * (force_N[-1] - level))]
    return float(np.quantile(rising, STEEPEST)) if len(rising) else np.inf

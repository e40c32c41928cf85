"""Squeezes of a rigid object in a recording of force and travel, their checks, and the gels' indentation."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from tactile.noise import noise_sd
from tactile.preparation.rows import true_runs
from tactile.readers.load_cell import UNLOADED_FRAMES
from tactile.readers.recording import GelPad
from tactile.tactile_failure import TactileFailure, TactileProblem

LEAST_OVER_NOISE = 20.0
"""Least peak force over the noise of one frame; below it the curve is noise. Set by hand."""
TOUCHED, TOUCHED_SHARE = 6.0, 0.02
"""Force above which there is contact: this many standard deviations of its noise, and this share of the
largest. Set by hand."""
WEAK = 0.5
"""Least peak of a squeeze over the largest one's; weaker episodes are ignored. Set by hand."""
FEWEST_READINGS = 4
"""Fewest new readings of the travel while loading; fewer show no curvature. Set by hand."""
FALL = 0.1
"""Share of the peak by which force (or travel) may fall while loading. Set by hand: beyond it something
slipped or broke."""
CREEP = 0.15
"""Largest share of the peak force lost by the second half of a hold. Set by hand between gels, which lose 2
to 6 % in a golf ball's squeezes, and meat, which loses 43 to 72 % in 10 s."""
STANDS = 0.05
"""Share of the travel by which it may change in a hold. Set by hand."""
SET = 0.4
"""Largest share of the travel that remains when the force has fallen to a tenth. Set by hand."""
SOFTENS = 1.5
"""Largest ratio of the travel's slope over the upper half of the force to that over the lower half, beyond
three standard errors. A contact stiffens; yielding or slip does not. Set by hand."""
NOT_RIGID = 0.5
"""Largest travel over the object's size: beyond it the object broke, or its size has another unit."""
UNDER = 0.5
"""Least indentation, over that of the deepest marker, of a marker under the object. Set by hand."""
FEWEST_UNDER = 4
"""Fewest markers under a ball for a fit of its lowest point: three unknowns, and one to spare."""


@dataclass(frozen=True, kw_only=True)
class RigidPress:
    """Force (N, from the load cell's zero) and travel (mm) while loading, and while unloading (`back_`).

    Only new readings of the travel are kept: one that is constant while the force changes is stale.
    `part_mm`: the gels' own travel in the same frames, if known, else zeros. `held`: force kept at constant
    travel, over the peak; 1 without a hold.
    """

    source: str
    force_N: Float[np.ndarray, " t"]
    travel_mm: Float[np.ndarray, " t"]
    part_mm: Float[np.ndarray, " t"]
    back_force_N: Float[np.ndarray, " u"]
    back_travel_mm: Float[np.ndarray, " u"]
    held: float

    @property
    def largest_N(self) -> float:
        """The peak force, N."""
        return float(self.force_N.max())


def rigid_squeezes(
    force_N: Float[np.ndarray, " t"],
    travel_mm: Float[np.ndarray, " t"],
    *,
    part_mm: Float[np.ndarray, " t"] | None,
    size_mm: float,
    source: str,
) -> tuple[RigidPress, ...]:
    """Every squeeze in a recording: contact, loading to a peak, and unloading if it was recorded.

    `travel_mm` grows as the jaws close. Raises TactileFailure (unreadable-frames) for too little force or too
    few readings. It also raises if the force falls as the travel grows, or at constant travel. So it does if
    the travel does not return, or grows faster at higher force.
    """
    noise = noise_sd(force_N)
    pushed = force_N - float(np.median(force_N[:UNLOADED_FRAMES]))
    largest = float(pushed.max(initial=0.0))
    if not largest > LEAST_OVER_NOISE * noise:
        fault = f"a largest force of {largest:.3g} N in noise of {noise:.2g} N"
        raise _no_squeeze(source, fault, f"{LEAST_OVER_NOISE:.0f} times the noise", "squeeze harder")
    touched = pushed > max(TOUCHED * noise, TOUCHED_SHARE * largest)
    part = np.zeros(len(force_N)) if part_mm is None else part_mm
    return tuple(
        _squeeze(pushed, travel_mm, part, frames, noise_N=noise, size_mm=size_mm, source=source)
        for frames in (slice(first, end) for first, end in true_runs(touched))
        if pushed[frames].max() > WEAK * largest
    )


def _squeeze(
    force: Float[np.ndarray, " t"],
    travel: Float[np.ndarray, " t"],
    part: Float[np.ndarray, " t"],
    frames: slice,
    *,
    noise_N: float,
    size_mm: float,
    source: str,
) -> RigidPress:
    """One contact episode; raises TactileFailure if a check fails."""

    def require(holds: object, observed: str, expected: str, advice: str) -> None:
        if not holds:
            raise _no_squeeze(source, observed, expected, advice)

    peak = frames.start + int(np.argmax(force[frames]))
    most = float(force[peak])
    into = np.arange(frames.start, peak + 1)
    after = np.arange(peak + 1, frames.stop)
    into = into[_new_readings(travel[into])]
    next_reading = after[np.diff(travel[peak : frames.stop]) != 0.0][:1]
    if (force[next_reading] > (1 - FALL) * most).all():
        into = np.r_[into, next_reading]
    observed = f"{len(into)} readings of the travel on the way to {most:.3g} N"
    advice = "close the jaws slower, or record more often"
    require(len(into) >= FEWEST_READINGS, observed, f"{FEWEST_READINGS} or more", advice)
    gone = float(travel[into].max() - travel[into[0]])
    observed = f"a travel that goes {gone:.3g} mm as the force grows to {most:.3g} N"
    require(gone > 0.0, observed, "one that grows", "give it its sign, or the gap as a gap")
    observed = f"{gone:.3g} mm of travel on an object of {size_mm:g} mm"
    expected = f"at most {NOT_RIGID:.0%} of its size"
    require(gone <= NOT_RIGID * size_mm, observed, expected, "squeeze what is rigid; sizes are in mm")
    fallen = _back(force[into])
    observed = f"a force that falls by {fallen:.3g} of {most:.3g} N while the travel goes on"
    advice = "squeeze an object that neither slips nor breaks"
    require(fallen <= FALL * most + TOUCHED * noise_N, observed, "one that grows", advice)
    lost = _back(travel[into])
    observed = f"a travel that goes back by {lost:.3g} of {gone:.3g} mm while the force grows"
    advice = "check that force and travel have one clock"
    require(lost <= FALL * gone + TOUCHED * noise_sd(travel[into]), observed, "one that grows", advice)
    _require_stiffening(force[into], travel[into], source)
    stands = travel[after] > travel[: peak + 1].max() - STANDS * gone
    still = after[: len(after) if stands.all() else int(np.argmin(stands))]
    # In the last frames the jaws may already open, although the reading of the travel has not changed.
    held = float(np.median(force[still[len(still) // 2 :]])) / most if len(still) else 1.0
    observed = f"{1 - held:.0%} of the force lost while the travel stands still"
    require(held >= 1 - CREEP, observed, f"at most {CREEP:.0%}", "squeeze an object that does not relax")
    back = after[len(still) :]
    back = back[_new_readings(travel[back])]
    low = back[(force[back] < 0.2 * most) & (force[back] > 0.05 * most)]
    if len(low):
        in_there = float(np.interp(np.median(force[low]), np.sort(force[into]), np.sort(travel[into])))
        stays = (float(np.median(travel[low])) - in_there) / gone
        observed = f"{stays:.0%} of the travel left as the force comes back to {np.median(force[low]):.3g} N"
        within = stays <= SET or stays * gone <= TOUCHED * noise_sd(travel[back])
        require(within, observed, f"at most {SET:.0%}", "squeeze an object that is not dented")
    return RigidPress(
        source=source,
        force_N=force[into],
        travel_mm=travel[into],
        part_mm=part[into],
        back_force_N=force[back],
        back_travel_mm=travel[back],
        held=held,
    )


def _require_stiffening(force: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"], source: str) -> None:
    """Raises TactileFailure if travel is clearly steeper over the upper half of the force than the lower."""
    half = 0.5 * (force.min() + force.max())
    slopes = []
    for part in (force <= half, force >= half):
        if part.sum() < FEWEST_READINGS or np.ptp(force[part]) == 0.0:
            return
        x, y = force[part] - force[part].mean(), travel[part] - travel[part].mean()
        slope = float(x @ y / (x @ x))
        scatter = float(((y - slope * x) ** 2).sum() / (part.sum() - 2))
        slopes.append((slope, scatter / float(x @ x)))
    (low, low_var), (high, high_var) = slopes
    if high > SOFTENS * low + 3 * float(np.sqrt(high_var + low_var)):
        fault = f"{high:.3g} mm/N over the upper half of the force and {low:.3g} mm/N over the lower"
        raise _no_squeeze(
            source, fault, "a travel that grows no faster at higher force", "squeeze what does not yield"
        )


def _new_readings(travel: Float[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
    """Frames whose travel differs from the frame before."""
    return np.asarray(np.r_[True, np.diff(travel) != 0.0][: len(travel)])


def _back(values: Float[np.ndarray, " t"]) -> float:
    """Largest fall below an earlier value."""
    return float((np.maximum.accumulate(values) - values).max())


def _no_squeeze(source: str, fault: str, expected: str, advice: str) -> TactileFailure:
    return TactileProblem.UNREADABLE_FRAMES.failure(
        f"{source}: no squeeze of a rigid object: found {fault}, expected {expected}; {advice}.",
    )


def gel_give_mm(pad: GelPad, *, shape: Literal["ball", "block"], size_mm: float) -> Float[np.ndarray, " t"]:
    """Indentation of the gel at the object's foremost point, mm, for each frame; 0 if nothing presses.

    Under a ball of radius R a touching marker has depth d - r^2/2R at distance r from the lowest point. Hence
    depth + (x^2 + y^2)/2R = a + b x + c y over the markers at least half as indented as the deepest, and
    d = a + R (b^2 + c^2)/2 (the sphere's paraboloid: off by r^4/8R^3). With fewer than four of these markers
    d is the greatest depth. Under a flat block d is their mean depth.
    """
    position = pad.rest_mm + pad.displacement_mm
    pressed = -pad.displacement_mm[:, :, 2]
    height = -position[:, :, 2]
    give_mm = np.zeros(len(pressed))
    for t in np.flatnonzero(pressed.max(axis=1) > 0):
        under = pressed[t] > UNDER * pressed[t].max()
        if shape == "block":
            give_mm[t] = float(height[t, under].mean())
        elif under.sum() < FEWEST_UNDER:
            give_mm[t] = float(height[t, under].max())
        else:
            give_mm[t] = _apex_mm(position[t, under, :2], height[t, under], radius_mm=size_mm / 2)
    return give_mm


def _apex_mm(places: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, " n"], *, radius_mm: float) -> float:
    """Depth of a ball's lowest point from markers under it, mm."""
    middle = places.mean(axis=0)
    around = places - middle
    rows = np.column_stack([np.ones(len(around)), around])
    raised = depth + (around**2).sum(axis=1) / (2 * radius_mm)
    a, b, c = np.linalg.lstsq(rows, raised, rcond=None)[0]
    return float(a + radius_mm * (b * b + c * c) / 2)

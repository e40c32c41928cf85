"""Which rows hold a reading of their own where a quantity is read more slowly than it is logged, and the rows
that two quantities of two rates have in common.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.noise import noise_sd

Values: TypeAlias = Float[np.ndarray, " t"]

FEWEST_CHANGES = 8
"""Changes of a value from which the rhythm of its readings is known."""
REGULAR = 0.9
"""Share of the changes that are whole periods apart."""
NEARLY = 0.1
"""Share of the median step by which steps may be off its whole multiples where they are a display's."""
OTHERS_CHANGE = 0.5
"""Share of the repeated rows in which another quantity changes: rows that repeat all are a pause."""
AT_ONCE = 0.6
"""Share of another quantity's change that comes in the row in which the value changes, where both step."""
DECIDES = 2.0
"""Difference of the squared residuals, in variances, that tells two places of a kink apart."""
REACH, OF_ONE_MORE = 1.5, 12.0
"""Periods fitted on both sides of a kink; variances that a second kink must gain."""
SLOW = 2.5
"""Rows a reading, below which the force's bend cannot tell."""
SHORTEST = 6
"""Rows on each side of a kink."""
SMALL = 0.1
"""Standard deviations of the force that an interpolated travel may move it by."""
FEWEST_ROWS = 40
"""Rows below which interpolated travels are kept however uncertain they are."""


@dataclass(frozen=True, kw_only=True)
class Rhythm:
    """`rows`: those with a reading of its own; `period`: rows from one reading to the next."""

    rows: Int[np.ndarray, " k"]
    period: float


def rhythm_of(values: Values, other: Values) -> tuple[Rhythm | None, bool]:
    """The readings of a value that is sampled and held, and whether its equal steps may be a display's.

    Readings come at whole periods of two rows or more, whatever the speed. A hold of the machine alone has no
    period, and a rounded value changes more often when it moves faster. Of equal steps at one speed both can
    be true.
    """
    at = np.flatnonzero(np.isfinite(values))
    changes = at[1:][np.diff(values[at]) != 0]
    if len(changes) < FEWEST_CHANGES:
        return None, False
    gaps = np.diff(changes).astype(float)
    period = float(gaps[gaps <= 1.5 * np.median(gaps)].mean())
    if period < 1.5:
        return None, False
    off = np.abs(gaps - period * np.maximum(np.rint(gaps / period), 1))
    if (off <= min(1.0, 0.3 * period)).mean() < REGULAR:
        return None, False
    repeated = np.setdiff1d(at[1:], changes)
    if not len(repeated) or (other[repeated] == other[repeated - 1]).mean() > 1 - OTHERS_CHANGE:
        return None, False
    if _moves_in_steps(values, other, changes):
        return None, False
    steps = np.abs(np.diff(values[at])[np.diff(values[at]) != 0])
    whole = steps / np.median(steps)
    of_display = bool((np.abs(whole - np.maximum(np.rint(whole), 1)) <= NEARLY).all())
    return Rhythm(rows=_grid(at[0], changes, period, at[-1]), period=period), of_display


def _moves_in_steps(values: Values, other: Values, changes: Int[np.ndarray, " c"]) -> bool:
    """Whether the other quantity changes when the value does, as it does where a machine moves in steps, and
    not in between.
    """
    sign = np.sign(values[changes[:-1]] - values[changes[:-1] - 1])
    at_change = sign * (other[changes[:-1]] - other[changes[:-1] - 1])
    in_all = sign * (other[changes[1:] - 1] - other[changes[:-1] - 1])
    known = np.isfinite(at_change) & np.isfinite(in_all)
    whole = float(in_all[known].sum())
    return whole > 0 and float(at_change[known].sum()) > AT_ONCE * whole


def _grid(first: int, changes: Int[np.ndarray, " c"], period: float, last: int) -> Int[np.ndarray, " k"]:
    """Rows of the changes, and every period between and after them, where the same value was read again."""
    rows = [first]
    for change in [*changes.tolist(), last + 1]:
        again = rows[-1] + period * np.arange(1, max(int((change - rows[-1]) / period - 0.5), 0) + 1)
        rows += np.rint(again).astype(int).tolist()
        if change <= last:
            rows.append(change)
    return np.unique(rows)


def is_held(values: Values, force_N: Values, rhythm: Rhythm) -> bool:
    """Whether equal steps are readings that come late, by where the force bends when the motion turns.

    With equal steps alone, a value that is sampled and held reaches its last place in the row in which the
    motion stops, and leaves it one period after the motion begins again. A rounded value stands still for
    the same time x after the one and before the other (a motion that turns at once: at the middle of its last
    place). Where the force does not tell, steps of 1, 2, 2.5 or 5 times a power of ten are taken for a
    display's.
    """
    at = np.flatnonzero(np.isfinite(values) & np.isfinite(force_N))
    changes = at[1:][np.diff(values[at]) != 0]
    steps = np.diff(values[at])[np.diff(values[at]) != 0]
    gaps, period = np.diff(changes), rhythm.period
    if period < SLOW:
        return False
    score = 0.0
    for k in range(1, len(changes) - 1):
        stops = gaps[k - 1] < 1.5 * period < gaps[k] or steps[k + 1] * steps[k] < 0
        if stops and steps[k] * steps[k - 1] > 0 and gaps[k - 1] < 1.5 * period:
            score += _held_by_kinks(force_N, int(changes[k]), int(changes[k + 1]), period)
    if abs(score) > DECIDES:
        return score > 0
    digits = f"{float(np.median(np.abs(steps))):.3e}".split("e")[0].replace(".", "").rstrip("0")
    return digits not in ("1", "2", "25", "5")


def _held_by_kinks(force_N: Values, last: int, begins: int, period: float) -> float:
    """How much better the force bends where a held value has it than where a rounded one has it, in variances
    of its noise; `last`, `begins`: rows of the last change before the turn and of the first one behind it.
    """
    near = min(1.0, period / 8) * np.linspace(-1, 1, 9)
    reach = max(round(REACH * period), SHORTEST)
    after = np.arange(0.0, min(period, (begins - last) / 2) + 0.01, max(period / 20, 0.25))
    noise = noise_sd(force_N[np.isfinite(force_N)]) ** 2
    left = begins - period
    if begins - last < 2 * reach:
        part = slice(last - reach, begins + reach + 1)
        held = [_misfit(force_N, part, (last + d, max(left, last) + d)) for d in near]
        noise = max(noise, float(np.min(held)) / (part.stop - part.start))
        apart = [OF_ONE_MORE * noise * (begins - last > 2 * d + 1) for d in after]
        rounded = [
            _misfit(force_N, part, (last + d, begins - d)) + more
            for d, more in zip(after, apart, strict=True)
        ]
    else:
        stops, starts = slice(last - reach, last + reach), slice(round(left) - reach, round(left) + reach)
        held = [_misfit(force_N, stops, (last + d,)) + _misfit(force_N, starts, (left + d,)) for d in near]
        rounded = [
            _misfit(force_N, stops, (last + d,)) + _misfit(force_N, starts, (begins - d,)) for d in after
        ]
    score = (min(rounded) - min(held)) / noise
    return score if np.isfinite(score) else 0.0


def _misfit(force_N: Values, part: slice, kinks: Sequence[float]) -> float:
    """Squared residuals of parabolas that meet at the kinks (rows); NaN where the record is shorter."""
    force = force_N[max(part.start, 0) : part.stop]
    if part.start < 0 or len(force) < part.stop - part.start or not np.isfinite(force).all():
        return np.nan
    scale = part.stop - part.start
    time = np.arange(part.start, part.stop) / scale
    columns = [np.ones(scale), time - time[0], (time - time[0]) ** 2]
    for kink in kinks:
        behind = np.maximum(time - kink / scale, 0.0)
        columns += [behind, behind**2]
    basis = np.stack(columns, axis=1)
    return float(((force - basis @ np.linalg.lstsq(basis, force, rcond=None)[0]) ** 2).sum())


def on_common_rows(
    time_s: Values, travel: Values, force_N: Values
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Rows of force readings and the travel there, interpolated where the row has none of its own.

    Rows that hold both readings are enough where there are nearly as many as of the slower quantity. Between
    two travels a force is kept where the interpolation moves it by less than SMALL of its noise; of every
    travel the nearest force is kept. Rows before the first and after the last travel are left out.
    """
    has_travel, has_force = np.isfinite(travel), np.isfinite(force_N)
    both = has_travel & has_force
    if both.sum() > 0.8 * min(has_travel.sum(), has_force.sum()):
        rows = np.flatnonzero(both)
        return rows, travel[rows]
    at, rows = np.flatnonzero(has_travel), np.flatnonzero(has_force)
    known = time_s[at]
    rows = rows[(time_s[rows] >= known[0]) & (time_s[rows] <= known[-1])]
    there = np.interp(time_s[rows], known, travel[at])
    keep = _well_known(time_s[rows], force_N[rows], known, travel[at])
    if keep.sum() < FEWEST_ROWS:
        keep[:] = True
    return rows[keep], there[keep]


def _well_known(
    time_s: Float[np.ndarray, " r"],
    force_N: Float[np.ndarray, " r"],
    known_s: Float[np.ndarray, " k"],
    travel: Float[np.ndarray, " k"],
) -> Bool[np.ndarray, " r"]:
    """Which forces lie where the travel between its readings is as good as known."""
    step = np.diff(known_s)
    speed = np.diff(travel) / step
    bend = np.abs(np.diff(speed))
    change = np.maximum(np.r_[0.0, bend], np.r_[bend, 0.0])  # of the speed, at the two ends of each interval
    error = change * step / 8
    level = np.interp(known_s, time_s, force_N)
    moved = np.maximum(np.abs(np.diff(travel)), 1e-12)
    slope = np.abs(np.diff(level)) / moved
    sure = error * np.maximum(slope, np.median(slope)) < SMALL * noise_sd(force_N)
    keep = sure[np.clip(np.searchsorted(known_s, time_s, side="right") - 1, 0, len(step) - 1)]
    after = np.clip(np.searchsorted(time_s, known_s), 1, len(time_s) - 1)
    nearest = np.where(known_s - time_s[after - 1] < time_s[after] - known_s, after - 1, after)
    keep[nearest] = True
    return np.asarray(keep)

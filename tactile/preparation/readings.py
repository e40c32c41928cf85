"""Which rows hold a reading of their own where a quantity is read more slowly than it is logged, and the rows
that two quantities of two rates have in common.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.preparation.noise import noise_sd

FEWEST_CHANGES = 8
"""Changes of a value from which the rhythm of its readings is known."""
REGULAR = 0.9
"""Share of the changes that are whole periods apart."""
NEARLY, MOSTLY = 0.1, 0.75
"""Steps within this share of the median step count as equal; this share of equal steps may be the steps of a
display instead."""
OTHERS_CHANGE = 0.5
"""Share of the repeated rows in which another quantity changes: rows that repeat all are a pause."""
DECIDES = 9.0
"""Difference of the squared residuals, in variances, that tells two places of a kink apart."""
LATE = 0.25
"""Periods behind the last change at which the force still bends: up to it the value is late (sampled and
held), beyond it the value is rounded, whose true motion goes on for half a step."""
SMALL = 0.1
"""Standard deviations of the force that an interpolated travel may move it by."""
FEWEST_ROWS = 40
"""Rows below which interpolated travels are kept however uncertain they are."""


@dataclass(frozen=True, kw_only=True)
class Rhythm:
    """`rows`: those with a reading of its own; `period`: rows from one reading to the next."""

    rows: Int[np.ndarray, " k"]
    period: float


def rhythm_of(values: Float[np.ndarray, " t"], other: Float[np.ndarray, " t"]) -> tuple[Rhythm | None, bool]:
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
    if (other[repeated] == other[repeated - 1]).mean() > 1 - OTHERS_CHANGE:
        return None, False
    steps = np.abs(np.diff(values[at])[np.diff(values[at]) != 0])
    equal = float((np.abs(steps - np.median(steps)) <= NEARLY * np.median(steps)).mean())
    return Rhythm(rows=_grid(at[0], changes, period, at[-1]), period=period), equal >= MOSTLY


def _grid(first: int, changes: Int[np.ndarray, " c"], period: float, last: int) -> Int[np.ndarray, " k"]:
    """Rows of the changes, and every period between and after them, where the same value was read again."""
    rows = [first]
    for change in [*changes.tolist(), last + 1]:
        again = rows[-1] + period * np.arange(1, max(int((change - rows[-1]) / period - 0.5), 0) + 1)
        rows += np.rint(again).astype(int).tolist()
        if change <= last:
            rows.append(change)
    return np.unique(rows)


def is_held(
    time_s: Float[np.ndarray, " t"],
    values: Float[np.ndarray, " t"],
    force_N: Float[np.ndarray, " t"],
    rhythm: Rhythm,
) -> bool:
    """Whether equal steps are readings that come late, by where the force bends when the motion stops.

    A sampled value reaches its last place after the motion stopped, a rounded one half a step before. Where
    the force does not tell, steps of 1, 2, 2.5 or 5 times a power of ten are taken for a display's.
    """
    at = np.flatnonzero(np.isfinite(values) & np.isfinite(force_N))
    changes = at[1:][np.diff(values[at]) != 0]
    up = np.sign(values[changes] - values[changes - 1])
    gaps = np.diff(changes)
    ends = [
        int(changes[k])
        for k in range(2, len(changes))
        if (gaps[k - 2 : k] < 1.5 * rhythm.period).all()
        and up[k - 2] == up[k - 1] == up[k]
        and (k == len(changes) - 1 or gaps[k] > 2 * rhythm.period or up[k + 1] != up[k])
    ]
    score = sum(_kink_score(time_s, force_N, end, rhythm.period) for end in ends)
    if abs(score) > DECIDES:
        return score > 0
    step = float(np.median(np.abs(np.diff(values[at])[np.diff(values[at]) != 0])))
    plain = f"{step:.4g}".replace(".", "").strip("0")
    return plain.split("e")[0].rstrip("0") not in ("1", "2", "25", "5")


def _kink_score(
    time_s: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"], end: int, period: float
) -> float:
    """How much better the force bends before `end` + LATE periods than after it, in variances of its noise."""
    reach = max(round(3 * period), 10)
    first, last = max(end - reach, 0), min(end + reach + 1, len(time_s))
    part = slice(first, last)
    if end - first < reach // 2 or last - end < reach // 2 or not np.isfinite(force_N[part]).all():
        return 0.0
    time, force = np.arange(first, last) - float(end), force_N[part]
    places = np.arange(-period, 1.5 * period + 0.25, max(period / 20, 0.25))
    squares = []
    for place in places:
        behind = np.maximum(time - place, 0.0)
        basis = np.stack([np.ones_like(time), time, time**2, behind, behind**2], axis=1) / [
            1, reach, reach**2, reach, reach**2
        ]  # fmt: skip
        squares.append(float(((force - basis @ np.linalg.lstsq(basis, force, rcond=None)[0]) ** 2).sum()))
    square = np.array(squares)
    early = places <= LATE * period
    return float((square[~early].min() - square[early].min()) / noise_sd(force_N[np.isfinite(force_N)]) ** 2)


def on_common_rows(
    time_s: Float[np.ndarray, " t"], travel: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]
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

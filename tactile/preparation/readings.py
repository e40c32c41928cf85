"""Which rows hold a new reading of a quantity that is read more slowly than it is logged."""

from itertools import product

import numpy as np
from jaxtyping import Float, Int

from tactile.noise import noise_sd
from tactile.preparation.rows import Values

FEWEST_CHANGES = 8
"""Fewest changes of a value that determine the rhythm of its readings."""
REGULAR = 0.9
"""Share of the changes that are whole periods apart."""
NEARLY = 0.1
"""Share of the median step by which a display's steps may deviate from its whole multiples."""
OTHERS_CHANGE = 0.5
"""Share of the repeated rows in which another quantity changes: rows that repeat all are a pause."""
AT_ONCE = 0.6
"""Share of another quantity's change in the rows in which the value changes, if a machine moves in steps."""
REACH, SHORTEST = 1.5, 6
"""Periods fitted on both sides of a kink, and rows at least."""
BENDS = 25.0
"""Variances of noise by which a kink must reduce the squared residual."""


def rhythm_of(values: Values, other: Values) -> tuple[Int[np.ndarray, " k"], float] | None:
    """Rows with a new reading of a value that is sampled and held, and rows from one reading to the next;
    None if every row has one, or if the value is rounded.

    Readings come at whole periods of two rows or more at any speed. A hold of the machine alone has no
    period, and a rounded value changes more often when it moves faster. `other`: the force, or the travel if
    the value is a force. It decides whether equal steps at one speed are a display's (`_is_held`).
    """
    at = np.flatnonzero(np.isfinite(values))
    changes = at[1:][np.diff(values[at]) != 0]
    if len(changes) < FEWEST_CHANGES:
        return None
    gaps = np.diff(changes).astype(float)
    period = float(gaps[gaps <= 1.5 * np.median(gaps)].mean())
    off = np.abs(gaps - period * np.maximum(np.rint(gaps / period), 1))
    if period < 1.5 or (off <= min(1.0, 0.3 * period)).mean() < REGULAR:
        return None
    repeated = np.setdiff1d(at[1:], changes)
    if not len(repeated) or (other[repeated] == other[repeated - 1]).mean() > 1 - OTHERS_CHANGE:
        return None
    if _moves_in_steps(values, other, changes):
        return None
    steps = np.diff(values[at])[np.diff(values[at]) != 0]
    whole = np.abs(steps) / np.median(np.abs(steps))
    equal = (np.abs(whole - np.maximum(np.rint(whole), 1)) <= NEARLY).all()
    if equal and not _is_held(changes, steps, other, period):
        return None
    return _grid(at[0], changes, period, at[-1]), period


def _moves_in_steps(values: Values, other: Values, changes: Int[np.ndarray, " c"]) -> bool:
    """Whether the other quantity changes mostly in the rows in which the value does, as if a machine moves in
    steps.
    """
    sign = np.sign(values[changes[:-1]] - values[changes[:-1] - 1])
    at_change = sign * (other[changes[:-1]] - other[changes[:-1] - 1])
    in_all = sign * (other[changes[1:] - 1] - other[changes[:-1] - 1])
    known = np.isfinite(at_change) & np.isfinite(in_all)
    whole = float(in_all[known].sum())
    return whole > 0 and float(at_change[known].sum()) > AT_ONCE * whole


def _grid(first: int, changes: Int[np.ndarray, " c"], period: float, last: int) -> Int[np.ndarray, " k"]:
    """Rows of the changes, and every period between and after them at which the same value was read again."""
    rows = [first]
    for change in [*changes.tolist(), last + 1]:
        again = rows[-1] + period * np.arange(1, max(int((change - rows[-1]) / period - 0.5), 0) + 1)
        rows += np.rint(again).astype(int).tolist()
        if change <= last:
            rows.append(change)
    return np.unique(rows)


def _is_held(
    changes: Int[np.ndarray, " c"], steps: Float[np.ndarray, " c"], force_N: Values, period: float
) -> bool:
    """Whether equal steps are late readings, from where the force bends when the motion stops and restarts.

    A value that is sampled and held reaches its last place in the row in which the motion stops. It leaves
    that place one period after the motion begins again. A rounded value stands still for about as long before
    the stop as after the restart. If the force bends too little, steps of 1, 2, 2.5 or 5 times a power of ten
    count as a display's.
    """
    gaps, late = np.diff(changes), []
    reach, step = max(round(REACH * period), SHORTEST), max(period / 10, 0.25)
    for k in range(1, len(changes) - 1):
        if gaps[k - 1] > 1.5 * period or steps[k] * steps[k - 1] < 0:
            continue
        last, begins = int(changes[k]), int(changes[k + 1])
        stops = np.arange(last - 0.5, last + period + 0.51, step)
        starts = np.arange(begins - period - 0.5, begins + 0.51, step)
        if begins - last > 4 * period:
            stop = _kinks(force_N, slice(last - reach, round(last + period) + reach), stops)[0]
            start = _kinks(force_N, slice(round(begins - period) - reach, begins + reach), starts)[0]
        elif begins - last > 1.5 * period:
            stop, start = _kinks(force_N, slice(last - reach, begins + reach), stops, starts)
        elif steps[k + 1] * steps[k] < 0:  # it turns at once
            stop = start = _kinks(force_N, slice(last - reach, begins + reach), stops)[0]
        else:
            continue
        late.append((begins - start - (stop - last)) / period)
    known = [share for share in late if np.isfinite(share)]
    if known:
        return float(np.median(known)) > 0.5
    digits = f"{float(np.median(np.abs(steps))):.3e}".split("e")[0].replace(".", "").rstrip("0")
    return digits not in ("1", "2", "25", "5")


def _kinks(force_N: Values, part: slice, *places: Float[np.ndarray, " p"]) -> tuple[float, ...]:
    """For each kink the place (row) among its `places` at which parabolas that meet there fit the force best;
    NaN if the force bends too little, or the record does not hold all of `part`.
    """
    force = force_N[max(part.start, 0) : part.stop]
    unknown = len(places) * (float("nan"),)
    if part.start < 0 or len(force) < part.stop - part.start or not np.isfinite(force).all():
        return unknown
    rows = np.arange(part.start, part.stop, dtype=float)

    def misfit(kinks: tuple[float, ...]) -> float:
        ramps = [np.maximum(rows - kink, 0.0) / len(rows) for kink in kinks]
        basis = np.column_stack([np.vander((rows - rows[0]) / len(rows), 3), *ramps, *np.square(ramps)])
        return float(((force - basis @ np.linalg.lstsq(basis, force, rcond=None)[0]) ** 2).sum())

    best = min(product(*places), key=misfit)
    left = misfit(best)
    noise = max(noise_sd(force_N[np.isfinite(force_N)]) ** 2, left / len(rows))
    return best if misfit(()) - left > BENDS * noise else unknown

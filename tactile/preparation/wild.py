"""Isolated readings that leave the smooth course of a record and come back to it within a few rows."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import percentile_filter

from tactile.noise import noise_sd

Values: TypeAlias = Float[np.ndarray, " t"]

LONGEST = 3
"""Consecutive wild rows: longer excursions may be the specimen's."""
ABOVE_NOISE, ABOVE_STEPS = 8.0, 6.0
"""Standard deviations of noise, and multiples of the usual step near it, that a wild value is off."""
RETURNS = 0.25
"""Share of its deviation by which the rows on both sides of a wild value may differ from each other."""
SHARP = 0.35
"""Share of the largest deviation that each edge of a wild block has: a tooth with a slow side is none."""
OUTSIDE = 0.5
"""Of the record's range: a value so far beyond it is wild, however slow its edges are."""
NEIGHBOURS, STEP_PERCENTILE = 31, 70
"""Rows over which the usual step is taken, and its percentile: one that several wild values do not reach, but
the changes of a value that is repeated up to three times do."""
IN_PART = 0.1
"""Share of the load that a crack leaves; below it the force is as good as gone, and does not come back."""
ROUNDS = 3
"""Wild values near each other hide each other at first."""
FEWEST = 8
"""Rows of a record in which a course can be seen."""
FAR_OUT = 20.0
"""Multiples of the remaining record's length by which a first or last time is off."""


def wild(values: Values) -> Bool[np.ndarray, " t"]:
    """Which values are wild; none of a NaN.

    A block of up to LONGEST values is wild where each is off the line between the values on both sides by
    ABOVE_NOISE and ABOVE_STEPS, both edges are sharp, and the record goes on where it was (RETURNS). A
    rupture, a release or a reset does not come back; a tooth of a serrated curve has one steep side alone.
    """
    outlier = np.zeros(len(values), dtype=bool)
    for _ in range(ROUNDS):
        at = np.flatnonzero(np.isfinite(values) & ~outlier)
        if len(at) < FEWEST:
            break
        off = _off_course(values[at])
        if not off.any():
            break
        outlier[at[off]] = True
    return outlier


def of_specimen(
    off: Bool[np.ndarray, " t"], values: Values, other: Values, *, of_force: bool
) -> Bool[np.ndarray, " t"]:
    """Which values off their course the specimen and the machine can have caused, none of a NaN.

    Of place and force (`other`: the one that `values` are not): both leave together, as they do over the rest
    of the record and within its range (a tap). Of the force alone: a crack unloads it in part while the
    machine presses on. A value of exactly zero is neither.
    """
    caused = np.zeros(len(values), dtype=bool)
    both = np.flatnonzero(np.isfinite(values) & np.isfinite(other))
    sound = both[~off[both] & ~wild(other)[both]]
    if len(sound) < FEWEST or not off.any():
        return caused
    every = np.arange(len(values))
    gone = values - np.interp(every, sound, values[sound])
    there = np.interp(every, sound, other[sound])
    follows = float(np.sign(np.cov(values[sound], other[sound])[0, 1]))
    least = np.interp(every, both, _least(other[both]))
    together = (follows * gone * (other - there) > 0) & (np.abs(other - there) > least)
    together &= _within(values, values[sound]) & _within(other, other[sound])
    for block in np.split(np.flatnonzero(off), np.flatnonzero(np.diff(np.flatnonzero(off)) > 1) + 1):
        caused[block] = together[block].any()
    if of_force:
        onward = follows * (there - there[np.maximum(every - NEIGHBOURS // 2, 0)])
        caused |= _unloaded_in_part(values, gone, sound, onward)
    return np.asarray(caused & off & (values != 0))


def _within(values: Values, sound: Float[np.ndarray, " s"]) -> Bool[np.ndarray, " t"]:
    beyond = OUTSIDE * float(np.ptp(sound))
    return np.asarray((values >= sound.min() - beyond) & (values <= sound.max() + beyond))


def _unloaded_in_part(
    force_N: Values, gone: Values, sound: Int[np.ndarray, " s"], onward: Values
) -> Bool[np.ndarray, " t"]:
    """Forces below their course that keep a clear part of its load while the machine presses on (`onward`: by
    how much the place changes, positive where the force grows with it).
    """
    known = force_N[sound]
    air = min(float(np.median(known[:FEWEST])), float(np.median(known[-FEWEST:])), key=abs)
    sign = 1.0 if known.max() - air >= air - known.min() else -1.0
    load, course = sign * (force_N - air), sign * (force_N - gone - air)
    clear = np.maximum(ABOVE_NOISE * noise_sd(known), IN_PART * course)
    return np.asarray((load > clear) & (load < course) & (sign * onward > 0))


def _least(values: Values) -> Values:
    """How far off its course a wild value is at least."""
    steps = np.abs(np.diff(values))
    usual = percentile_filter(steps, STEP_PERCENTILE, size=min(NEIGHBOURS, len(steps)), mode="nearest")
    return np.asarray(np.maximum(ABOVE_NOISE * noise_sd(values), ABOVE_STEPS * np.r_[usual[0], usual]))


def _off_course(values: Values) -> Bool[np.ndarray, " t"]:
    least = _least(values)
    off = np.zeros(len(values), dtype=bool)
    low, high = np.percentile(values, [2, 98])
    low, high = low - OUTSIDE * (high - low), high + OUTSIDE * (high - low)
    for width in range(1, LONGEST + 1):
        first = np.arange(1, len(values) - width)
        before, after = values[first - 1], values[first + width]
        inside = first[:, None] + np.arange(width)
        share = (1 + np.arange(width)) / (width + 1)
        gone = np.abs(values[inside] - (before[:, None] * (1 - share) + after[:, None] * share))
        most = gone.max(axis=1)
        outside = ((values[inside] < low) | (values[inside] > high)).any(axis=1)
        edges = np.minimum(np.abs(values[first] - before), np.abs(after - values[first + width - 1]))
        isolated = (
            (gone > least[inside]).all(axis=1)
            & (outside | (edges > SHARP * most))
            & (np.abs(after - before) < RETURNS * gone.min(axis=1))
            & ~off[inside].any(axis=1)
        )
        off[inside[isolated].ravel()] = True
    return off


def wild_times(time_s: Values) -> Bool[np.ndarray, " t"]:
    """Which times are off the increasing course of the rows on both sides; NaN is none."""
    outlier = np.zeros(len(time_s), dtype=bool)
    at = np.flatnonzero(np.isfinite(time_s))
    if len(at) < FEWEST:
        return outlier
    time = time_s[at]
    for k in np.flatnonzero(np.diff(time) < 0):
        high = next((j for j in range(1, LONGEST + 1) if k - j >= 0 and time[k + 1] > time[k - j]), 0)
        low = next(
            (j for j in range(1, LONGEST + 1) if k + j + 1 < len(time) and time[k + j + 1] > time[k]), 0
        )
        if high:
            outlier[at[k - high + 1 : k + 1]] = True
        elif low:
            outlier[at[k + 1 : k + low + 1]] = True
    for j in range(1, LONGEST + 1):
        for ends, gap, rest in (
            (at[:j], time[j] - time[j - 1], time[j:]),
            (at[-j:], time[-j] - time[-j - 1], time[:-j]),
        ):
            if np.abs(gap) > FAR_OUT * max(float(np.ptp(rest)), 1e-300) and (np.diff(rest) >= 0).mean() > 0.5:
                outlier[ends] = True
    return outlier


def run_starts(time_s: Values) -> Int[np.ndarray, " k"]:
    """Rows at which the time runs back, the first row included; wild times and NaN are passed over."""
    at = np.flatnonzero(np.isfinite(time_s) & ~wild_times(time_s))
    return np.r_[0, at[1:][np.diff(time_s[at]) < 0]] if len(at) else np.zeros(1, dtype=int)

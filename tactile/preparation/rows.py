"""Rows as the logger wrote them: which were never written, which values are wild, and where runs begin."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.noise import noise_sd

Values: TypeAlias = Float[np.ndarray, " t"]

LONGEST = 3
"""Most consecutive wild rows: longer excursions may be the specimen's."""
OUTSIDE = 0.5
"""Share of the record's range by which a wild value is outside it."""
ABOVE_NOISE, ABOVE_STEPS = 8.0, 6.0
"""Standard deviations of noise, and multiples of the usual large step, by which a value of exactly zero
deviates from its course."""
RETURNS = 0.25
"""Share of its deviation by which the rows on both sides of a wild value may differ from each other."""
FEWEST = 8
"""Fewest rows that show a course."""
JUMP = 10.0
"""Multiples of the usual large step by which a quantity jumps where written rows begin."""
LARGE = 95
"""Percentile of the steps that are not zero: the usual large step."""
FIRST = 5
"""Rows after a block whose median is compared: one of them may be wild."""
NEAR, STANDS, LOADED = 0.02, 0.05, 0.3
"""Share of the range within which a record returns to a place and a force. If a machine steps and holds:
share of a jump by which the place moves after it, and of the largest load that remains."""


def wild(values: Values) -> Bool[np.ndarray, " t"]:
    """Which values are wild; NaN is not.

    Up to LONGEST successive values are wild if they are far outside the record's range, or exactly zero off
    their course. The record must then continue where it was. A tap, a crack or a tooth of a serrated curve
    stays within the range; a rupture, a release or a reset does not return.
    """
    outlier = np.zeros(len(values), dtype=bool)
    at = np.flatnonzero(np.isfinite(values))
    if len(at) < FEWEST:
        return outlier
    known = values[at]
    low, high = np.percentile(known, [2, 98])
    margin = OUTSIDE * (high - low)
    beyond = (known < low - margin) | (known > high + margin)
    least = max(ABOVE_NOISE * noise_sd(known), ABOVE_STEPS * large_step(known[~beyond]))
    for first, end in true_runs(beyond | (known == 0)):
        if end - first > LONGEST or first == 0 or end == len(known):
            continue
        before, after = known[first - 1], known[end]
        gone = np.abs(known[first:end] - (before + after) / 2).min()
        far = gone > least or beyond[first:end].all()
        if far and abs(after - before) < RETURNS * gone:
            outlier[at[first:end]] = True
    return outlier


def true_runs(mask: Bool[np.ndarray, " t"]) -> list[list[int]]:
    """First row and end of each run of true rows."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False]))
    return edges.reshape(-1, 2).tolist()


def wild_times(time_s: Values) -> Bool[np.ndarray, " t"]:
    """Which times deviate from the increasing course of the rows on both sides; NaN does not."""
    outlier = np.zeros(len(time_s), dtype=bool)
    at = np.flatnonzero(np.isfinite(time_s))
    time = time_s[at]
    for k in np.flatnonzero(np.diff(time) < 0):
        for wide in range(
            1, LONGEST + 1
        ):  # the rows before the step are too late, or those behind it too early
            if k - wide >= 0 and time[k + 1] > time[k - wide]:
                outlier[at[k - wide + 1 : k + 1]] = True
                break
            if k + wide + 1 < len(time) and time[k + wide + 1] > time[k]:
                outlier[at[k + 1 : k + wide + 1]] = True
                break
    return outlier


def run_starts(time_s: Values) -> Int[np.ndarray, " k"]:
    """Rows at which the time runs back, and the first row; wild times and NaN are skipped."""
    at = np.flatnonzero(np.isfinite(time_s) & ~wild_times(time_s))
    return np.r_[0, at[1:][np.diff(time_s[at]) < 0]] if len(at) else np.zeros(1, dtype=int)


def runs(
    time_s: Values, breaks: Sequence[int] = (), *, of_topics: Sequence[Bool[np.ndarray, " t"]] = ()
) -> list[slice]:
    """The successive runs: each begins where the time runs back, or below a repeated header (`breaks`: first
    rows). Topics (`of_topics`: rows of each) form one run if the time of each continues.
    """
    if of_topics and all(len(run_starts(time_s[topic])) == 1 for topic in of_topics):
        return [slice(0, len(time_s))]
    starts = np.union1d(run_starts(time_s), np.array(breaks, dtype=int))
    ends = np.r_[starts[1:], len(time_s)]
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if b > a]


def unwritten_blocks(time_s: Values, columns: Sequence[Values]) -> list[slice]:
    """Blocks of rows at both ends that were never written, in order: each quantity is constant there.

    The first column is a place, which is constant at times; the others are noisy.
    """
    first, end = 0, len(time_s)
    blocks = list[slice]()
    for way in (1, -1):  # from the start on, then back from the end
        while first < end:
            held = [column[first:end][::way] for column in columns]
            length = _constant(held)
            if not _never_written(way * time_s[first:end][::way], held, length):
                break
            blocks.append(slice(first, first + length) if way == 1 else slice(end - length, end))
            first, end = (first + length, end) if way == 1 else (first, end - length)
    return sorted(blocks, key=lambda block: block.start)


def unwritten_inside(columns: Sequence[Values]) -> Bool[np.ndarray, " t"]:
    """Rows inside the record in blocks of one fill value, with a jump of every quantity at both ends."""
    same = np.all([_same(column[1:], column[:-1]) for column in columns], axis=0)
    inside = np.zeros(len(columns[0]), dtype=bool)
    for first, end in true_runs(np.r_[same, False] | np.r_[False, same]):
        if end - first <= LONGEST or first == 0 or end == len(inside):
            continue
        rest = [np.delete(column, np.s_[first:end]) for column in columns]
        jumps = [
            min(abs(column[first] - column[first - 1]), abs(column[end] - column[end - 1]))
            > JUMP * large_step(after)
            for column, after in zip(columns, rest, strict=True)
        ]
        inside[first:end] = all(jumps) and _is_fill([column[first] for column in columns], rest)
    return inside


def _never_written(time_s: Values, columns: Sequence[Values], length: int) -> bool:
    """Whether the first `length` rows, all of one value, were not measured.

    They are empty, or their time is constant, or all quantities hold a fill value. The record jumps from a
    fill value and does not return to it.
    """
    held = [float(column[0]) for column in columns]
    if np.isnan(time_s[0]) or np.isnan(held).all():
        return True
    if length == len(time_s):
        return False
    if length > 1 and not (np.diff(time_s[:length]) != 0).any():
        return True
    rest = [column[length:] for column in columns]
    if np.isnan(held).any() or not _is_fill(held, rest):
        return False
    if time_s[length] < time_s[length - 1]:
        return True
    return len(rest[0]) >= FEWEST and _jumps(held, rest) and not _was_measured(held, rest)


def _constant(columns: Sequence[Values]) -> int:
    """Number of rows at the start in which every quantity is constant."""
    differs = np.any([~_same(column, column[0]) for column in columns], axis=0)
    return int(np.argmax(differs)) if differs.any() else len(differs)


def _is_fill(held: Sequence[float], rest: Sequence[Float[np.ndarray, " r"]]) -> bool:
    """Whether all quantities hold one number, or each a number far beyond the record's range."""
    beyond = []
    for value, values in zip(held, rest, strict=True):
        known = values[np.isfinite(values)]
        low, high = np.percentile(known, [2, 98]) if len(known) else (value, value)
        beyond.append(not low - (high - low) <= value <= high + (high - low))
    return len(set(held)) == 1 or all(beyond)


def _jumps(held: Sequence[float], rest: Sequence[Float[np.ndarray, " r"]]) -> bool:
    """Whether a quantity jumps where the rows of one value end."""
    return any(
        abs(np.nanmedian(after[np.isfinite(after)][:FIRST]) - value) > JUMP * large_step(after)
        for value, after in zip(held, rest, strict=True)
        if np.isfinite(after).any()
    )


def _was_measured(held: Sequence[float], rest: Sequence[Float[np.ndarray, " r"]]) -> bool:
    """Whether place and force of a block can be those of a machine at rest in air: the record returns to
    both, or holds under load after the block.
    """
    place, force = rest
    known = np.isfinite(place) & np.isfinite(force) & ~wild(place) & ~wild(force)
    other = _constant([place[::-1], force[::-1]])
    if (place[-1], force[-1]) == tuple(held) and other < len(place):  # the same block at the other end
        inner = [column[: len(column) - other][::-1] for column in rest]
        known[len(known) - other :] &= not _jumps(held, inner)
    place, force = place[known], force[known]
    if len(place) < FEWEST:
        return False
    near_N = max(NEAR * float(np.ptp(force)), 6 * noise_sd(force))
    returns = (np.abs(place - held[0]) <= NEAR * np.ptp(place)) & (np.abs(force - held[1]) <= near_N)
    stands = np.ptp(place) <= STANDS * np.abs(place - held[0]).min()
    load = np.abs(force - held[1])
    loaded = abs(held[1]) < np.abs(force).min() and load.min() >= LOADED * load.max()
    return bool(returns.any() or (stands and loaded))


def large_step(values: Values) -> float:
    """The usual large step from row to row."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    steps = steps[steps > 0]
    return float(np.percentile(steps, LARGE)) if len(steps) else 0.0


def _same(column: Values, other: Values | float) -> Bool[np.ndarray, " t"]:
    return np.asarray((column == other) | (np.isnan(column) & np.isnan(other)))

"""Rows that were allocated and never written: a block in which every quantity keeps one value."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

JUMP = 10.0
"""Multiples of the usual large step by which a quantity jumps where written rows begin."""
LARGE = 95
"""Percentile of the steps that are not zero: the usual large step."""
LONG = 8
"""Rows of exact zeros beside noise that never repeats itself, which no load cell reads."""
FEWEST = 8
"""Rows behind a block from which the usual step is known."""
FIRST = 5
"""Rows behind a block that are looked at together: one of them may be wild."""
SELDOM = 0.2
"""Share of rows that repeat the force of the row before, below which LONG exact repeats are no reading."""
LONGEST_WILD = 3
"""Rows of one value inside the record that count as wild, each by itself."""


def reserved_ends(
    time_s: Float[np.ndarray, " t"], columns: Sequence[Float[np.ndarray, " t"]]
) -> tuple[int, int]:
    """How many rows at the start, and how many at the end, were never written; of the columns the first is a
    place, which stands still at times, and the others are noisy.
    """
    start = _at_start(time_s, columns)
    turned = [one[start:][::-1] for one in columns]
    return start, _at_start(-time_s[start:][::-1], turned)


def reserved_inside(columns: Sequence[Float[np.ndarray, " t"]]) -> Bool[np.ndarray, " t"]:
    """Rows inside the record in blocks of one value, at both ends of which every quantity jumps."""
    rows = len(columns[0])
    inside = np.zeros(rows, dtype=bool)
    same = np.all([_same(one[1:], one[:-1]) for one in columns], axis=0)
    edges = np.flatnonzero(np.r_[True, ~same, True])
    limits = [JUMP * _large_step(one) for one in columns]
    for k in np.flatnonzero(np.diff(edges) > LONGEST_WILD).tolist():
        first, end = edges[k], edges[k + 1]
        if first > 0 and end < rows:
            jumps = [
                min(abs(one[first] - one[first - 1]), abs(one[end] - one[end - 1])) > limit
                for one, limit in zip(columns, limits, strict=True)
            ]
            inside[first:end] = all(jumps)
    return inside


def _at_start(time_s: Float[np.ndarray, " t"], columns: Sequence[Float[np.ndarray, " t"]]) -> int:
    """Rows in the block at the start; 0 where it was measured. Blocks of several values follow each other."""
    done, rows = 0, len(time_s)
    while done < rows - 1:
        each = [one[done:] for one in columns]
        differs = np.any([~_same(one, one[0]) for one in each], axis=0)
        length = int(np.argmax(differs)) if differs.any() else rows - done
        if length < rows - done and not _never_written(time_s[done:], each, length):
            break
        if length == rows - done:
            break
        done += length
    return done


def _never_written(
    time_s: Float[np.ndarray, " t"], columns: Sequence[Float[np.ndarray, " t"]], length: int
) -> bool:
    """Whether the first `length` rows, all of one value, were not measured."""
    nothing = [bool(np.isnan(one[0])) for one in (time_s, *columns)]
    stands = length > 1 and not (np.diff(time_s[:length]) != 0).any()
    back = time_s[length] < time_s[length - 1]
    whole_behind = np.isfinite([one[length] for one in columns]).all()
    if nothing[0] or stands or back or all(nothing[1:]) or (length == 1 and any(nothing) and whole_behind):
        return True
    if any(nothing):
        return False
    rest = [one[length:] for one in columns]
    alone = len(columns) == 1 and columns[0][0] > 0  # a place may stand and then jump: a machine's approach
    if alone or len(rest[0]) < FEWEST:
        return False
    jumps = [
        abs(np.median(after[np.isfinite(after)][:FIRST]) - one[0]) > JUMP * _large_step(after)
        for one, after in zip(columns, rest, strict=True)
        if np.isfinite(after).any()
    ]
    if any(jumps) and (length > 1 or all(jumps)):
        return True
    repeats = [float(_same(one[1:], one[:-1]).mean()) if len(one) > 1 else 1.0 for one in rest[1:]]
    noisy = bool(repeats) and max(repeats) < SELDOM
    return length >= LONG and noisy and all(one[0] == columns[0][0] for one in columns)


def _large_step(values: Float[np.ndarray, " t"]) -> float:
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    steps = steps[steps > 0]
    return float(np.percentile(steps, LARGE)) if len(steps) else 0.0


def _same(one: Float[np.ndarray, " t"], other: Float[np.ndarray, " t"] | float) -> Bool[np.ndarray, " t"]:
    return np.asarray((one == other) | (np.isnan(one) & np.isnan(other)))

"""Rows as the logger wrote them: which were never written (a block in which every quantity keeps one value),
which times are wild, and where runs begin.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.noise import noise_sd
from tactile.preparation.logger_correction import LoggerCorrection, LoggerFault, Words, correction, listed
from tactile.preparation.wild import run_starts, wild, wild_times

Values: TypeAlias = Float[np.ndarray, " t"]

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
NEAR = 0.02
"""Share of the range within which the record comes back to a place or a force."""
AS_FAST = 0.4
"""Share of a jump that one row elsewhere has, in place and force at once: a machine moves as fast there."""
STANDS, LOADED = 0.05, 0.3
"""Share of a jump by which the place moves behind it, and of the largest load that stays: a step's hold."""
Columns = Mapping[str, Values]

FEWEST_IN_RUN = 8
"""Rows of the shortest run; fewer are times out of order."""


def reserved_ends(time_s: Values, columns: Sequence[Values]) -> tuple[int, int]:
    """How many rows at the start, and how many at the end, were never written; of the columns the first is a
    place, which stands still at times, and the others are noisy.
    """
    start = _at_start(time_s, columns)
    turned = [column[start:][::-1] for column in columns]
    return start, _at_start(-time_s[start:][::-1], turned)


def reserved_inside(columns: Sequence[Values]) -> Bool[np.ndarray, " t"]:
    """Rows inside the record in blocks of one fill value, at both ends of which every quantity jumps."""
    rows = len(columns[0])
    inside = np.zeros(rows, dtype=bool)
    same = np.all([_same(column[1:], column[:-1]) for column in columns], axis=0)
    edges = np.flatnonzero(np.r_[True, ~same, True])
    limits = [JUMP * _large_step(column) for column in columns]
    for k in np.flatnonzero(np.diff(edges) > LONGEST_WILD).tolist():
        first, end = edges[k], edges[k + 1]
        if first > 0 and end < rows:
            jumps = [
                min(abs(column[first] - column[first - 1]), abs(column[end] - column[end - 1])) > limit
                for column, limit in zip(columns, limits, strict=True)
            ]
            rest = [np.delete(column, np.s_[first:end]) for column in columns]
            inside[first:end] = all(jumps) and _is_fill([column[first] for column in columns], rest)
    return inside


def _at_start(time_s: Values, columns: Sequence[Values]) -> int:
    """Rows in the blocks at the start that were never written; 0 where they were measured."""
    done, rows = 0, len(time_s)
    while done < rows - 1:
        each = [column[done:] for column in columns]
        length = _block(each)
        if length == rows - done or not _never_written(time_s[done:], each, length):
            break
        done += length
    return done


def _block(columns: Sequence[Values]) -> int:
    """How many rows at the start hold one value of each quantity."""
    differs = np.any([~_same(column, column[0]) for column in columns], axis=0)
    return int(np.argmax(differs)) if differs.any() else len(differs)


def _never_written(time_s: Values, columns: Sequence[Values], length: int) -> bool:
    """Whether the first `length` rows, all of one value, were not measured."""
    nothing = [bool(np.isnan(column[0])) for column in (time_s, *columns)]
    rest = [column[length:] for column in columns]
    if nothing[0] or all(nothing[1:]):
        return True
    fill = _is_fill([column[0] for column in columns], rest)
    stands = length > 1 and not (np.diff(time_s[:length]) != 0).any()
    back = time_s[length] < time_s[length - 1]
    if stands or (back and (length > 1 or fill)):
        return True
    if any(nothing):
        return length == 1 and bool(np.isfinite([column[0] for column in rest]).all())
    alone = len(columns) == 1 and columns[0][0] > 0  # a place may stand and then jump: a machine's approach
    if alone or not fill or len(rest[0]) < FEWEST:
        return False
    jumps = _jumps([column[0] for column in columns], rest)
    if (all(jumps) or (any(jumps) and length > 1)) and not _was_measured(
        [column[0] for column in columns], rest
    ):
        return True
    noisy = [_is_noise_about(column[0], after) for column, after in zip(columns[1:], rest[1:], strict=True)]
    return length >= LONG and any(noisy)


def _is_fill(held: Sequence[float], rest: Sequence[Float[np.ndarray, " r"]]) -> bool:
    """Whether all quantities hold one number, or each a number that is far beyond the record's range."""
    beyond = []
    for value, values in zip(held, rest, strict=True):
        known = values[np.isfinite(values)]
        low, high = np.percentile(known, [2, 98]) if len(known) else (value, value)
        beyond.append(not low - (high - low) <= value <= high + (high - low))
    return len(set(held)) == 1 or all(beyond)


def _jumps(held: Sequence[float], rest: Sequence[Float[np.ndarray, " r"]]) -> list[bool]:
    """Of each quantity, whether it jumps where the rows of one value end."""
    return [
        bool(abs(np.median(after[np.isfinite(after)][:FIRST]) - value) > JUMP * _large_step(after))
        for value, after in zip(held, rest, strict=True)
        if np.isfinite(after).any()
    ]


def _was_measured(held: Sequence[float], rest: Sequence[Float[np.ndarray, " r"]]) -> bool:
    """Whether place and force of a block can be a machine's that stands in the air: the record comes back to
    both, moves as fast elsewhere, or stays loaded at one place behind the block.
    """
    if len(rest) == 1:
        return False
    place, force = rest
    known = np.isfinite(place) & np.isfinite(force) & ~wild(place) & ~wild(force) & ~reserved_inside(rest)
    other = _block([place[::-1], force[::-1]])
    if (place[-1], force[-1]) == tuple(held) and other < len(place):  # the same block at the other end
        inner = [column[: len(column) - other][::-1] for column in rest]
        if any(_jumps(held, inner)):
            known[len(known) - other :] = False
    place, force = place[known], force[known]
    if len(place) < FEWEST:
        return False
    gone_mm, gone_N = np.abs(place - held[0]), np.abs(force - held[1])
    near = max(NEAR * float(np.ptp(force)), 6 * noise_sd(force))
    returns = (gone_mm <= NEAR * np.ptp(place)) & (gone_N <= near)
    steps_mm, steps_N = np.abs(np.diff(place)), np.abs(np.diff(force))
    as_fast = (steps_mm >= AS_FAST * gone_mm[0]) & (steps_N >= AS_FAST * gone_N[0])
    stays = np.ptp(place) <= STANDS * gone_mm[0] and gone_N.min() >= LOADED * gone_N.max()
    less = abs(held[1]) < np.abs(force).min()
    return bool(returns.any() or (gone_mm[0] > 0 and as_fast.any()) or (stays and less))


def _is_noise_about(value: float, after: Float[np.ndarray, " r"]) -> bool:
    """Whether readings that hardly ever repeat themselves scatter about this value, which a sensor that shows
    exactly this value in the air does not do.
    """
    repeats = float(_same(after[1:], after[:-1]).mean()) if len(after) > 1 else 1.0
    near = after[: 2 * LONG]
    return repeats < SELDOM and bool((near < value).any() and (near > value).any())


def _large_step(values: Values) -> float:
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    steps = steps[steps > 0]
    return float(np.percentile(steps, LARGE)) if len(steps) else 0.0


def _same(column: Values, other: Values | float) -> Bool[np.ndarray, " t"]:
    return np.asarray((column == other) | (np.isnan(column) & np.isnan(other)))


def written(
    words: Words, time_s: Values, columns: Columns, rows: Int[np.ndarray, " t"]
) -> tuple[Bool[np.ndarray, " t"], list[LoggerCorrection]]:
    """Which rows were written, and a note on each block at the start or the end that was not."""
    start, end = reserved_ends(time_s, list(columns.values()))
    keep = np.ones(len(time_s), dtype=bool)
    keep[:start] = keep[len(time_s) - end :] = False
    notes = [
        _reserved_note(words, place, {name: values[part] for name, values in columns.items()}, rows[part])
        for place, ends in (("start", slice(0, start)), ("end", slice(len(time_s) - end, len(time_s))))
        for part in _blocks(columns, ends)
    ]
    return keep, notes


def _blocks(columns: Columns, part: slice) -> list[slice]:
    """The blocks of one value of each quantity; rows that are not whole are one block."""
    if part.start == part.stop:
        return []
    held = np.stack([values[part] for values in columns.values()], axis=1)
    spoilt = np.isnan(held).any(axis=1)
    differs = (held[1:] != held[:-1]).any(axis=1) & ~(spoilt[1:] & spoilt[:-1])
    edges = [part.start, *(part.start + 1 + np.flatnonzero(differs)).tolist(), part.stop]
    return [slice(first, end) for first, end in pairwise(edges)]


def _reserved_note(
    words: Words, place: str, columns: Columns, rows: Int[np.ndarray, " k"]
) -> LoggerCorrection:
    held = {name: float(values[0]) for name, values in columns.items()}
    whole = not any(np.isnan(value) for value in held.values())
    units = dict(words.units)
    kept = ", ".join(f"{name} {words.value(name, value)}" for name, value in held.items() if name in units)
    how = "all hold" if len(rows) > 1 else "it holds"
    why = f"never written ({how} {kept})" if whole else "not whole"
    count = words.count(len(rows))
    says = f"{count} at the {place}, from {words.row} {rows[0]} on, {why}; drupe left out all of them."
    return correction(LoggerFault.RESERVED, ", ".join(held), rows, np.array(list(held.values())), says)


def runs(
    time_s: Values, breaks: Sequence[int] = (), *, of_topics: Sequence[Bool[np.ndarray, " t"]] = ()
) -> list[slice]:
    """The runs one below the other: each begins where the time runs back, or below a repeated header
    (`breaks`: first rows). Topics (`of_topics`: rows of each) are one run where the time of each goes on.
    """
    starts = np.union1d(run_starts(time_s), np.array(breaks, dtype=int))
    ends = np.r_[starts[1:], len(time_s)]
    spans = [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if b > a]
    if of_topics and all(len(run_starts(time_s[topic])) == 1 for topic in of_topics):
        return [slice(0, len(time_s))]
    return spans


def wild_or_repeated_times(
    words: Words,
    time_s: Values,
    columns: Columns,
    rows: Int[np.ndarray, " t"],
    *,
    of_topics: Sequence[Bool[np.ndarray, " t"]] = (),
) -> tuple[Bool[np.ndarray, " t"], list[LoggerCorrection]]:
    """Which rows are to be left out: those of a wild time (each topic by itself), and those written twice."""
    notes = []
    off = np.zeros(len(time_s), dtype=bool)
    for topic in of_topics or [np.ones(len(time_s), dtype=bool)]:
        off[topic] |= wild_times(time_s[topic])
    if off.any():
        notes.append(wild_note(words, "time", rows[off], time_s[off]))
    twice = np.zeros(len(time_s), dtype=bool)
    same = [np.diff(time_s) == 0]
    same += [
        (np.diff(column) == 0) | (np.isnan(column[1:]) & np.isnan(column[:-1])) for column in columns.values()
    ]
    twice[1:] = np.all(same, axis=0)
    if twice.any():
        at, times = rows[twice], time_s[twice]
        says = (
            f"{words.count(len(at))} appear twice ({listed(words, 'time', at, times)}); drupe left out the "
            "repeats."
        )
        notes.append(correction(LoggerFault.REPEATED, "time", at, times, says))
    return off | twice, notes


def wild_note(
    words: Words, quantity: str, rows: Int[np.ndarray, " k"], values: Float[np.ndarray, " k"]
) -> LoggerCorrection:
    """Wild readings of one quantity, left out."""
    many = "wild reading" if len(rows) == 1 else "wild readings"
    says = f"{len(rows)} {many} of {quantity} left out: {listed(words, quantity, rows, values)}."
    return correction(LoggerFault.WILD, quantity, rows, values, says)

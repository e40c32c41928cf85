"""Rows as the logger wrote them: which were never written, which times are wild, and where runs begin."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.preparation.logger_correction import LoggerCorrection, LoggerFault, Words, correction, listed
from tactile.preparation.reserved import reserved_ends
from tactile.preparation.wild import run_starts, wild_times

Columns = Mapping[str, Float[np.ndarray, " t"]]

FEWEST_IN_RUN = 8
"""Rows of the shortest run; fewer are times out of order."""


def written(
    words: Words, time_s: Float[np.ndarray, " t"], columns: Columns, rows: Int[np.ndarray, " t"]
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
    time_s: Float[np.ndarray, " t"],
    breaks: Sequence[int] = (),
    *,
    of_topics: Sequence[Bool[np.ndarray, " t"]] = (),
) -> list[slice]:
    """The runs one below the other: each begins where the time runs back, or below a repeated header
    (`breaks`: first rows). Topics (`of_topics`: rows of each) are one run where the time of each goes on.
    """
    starts = np.union1d(run_starts(time_s), np.array(breaks, dtype=int))
    ends = np.r_[starts[1:], len(time_s)]
    found = [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if b > a]
    if of_topics and all(len(run_starts(time_s[topic])) == 1 for topic in of_topics):
        return [slice(0, len(time_s))]
    return found


def wild_or_repeated_times(
    words: Words,
    time_s: Float[np.ndarray, " t"],
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
    same += [(np.diff(one) == 0) | (np.isnan(one[1:]) & np.isnan(one[:-1])) for one in columns.values()]
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

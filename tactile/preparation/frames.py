"""Frames of a recording, or rows of a grasp's log: the same step as a trace's, but a spoilt value is replaced
from its neighbours, since the frame's pictures or markers count.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactile.preparation.logged_trace import MOST_CORRECTED, NotPrepared, written
from tactile.preparation.logger_correction import (
    LoggerCorrection,
    LoggerFault,
    Words,
    correction,
    listed,
    spoilt_said,
)
from tactile.preparation.readings import rhythm_of
from tactile.preparation.rows import runs, wild, wild_times

Values = Float[np.ndarray, " t"]


@dataclass(frozen=True, kw_only=True)
class PreparedFrames:
    """`part`: the frames that were written; times and columns are theirs, without holes."""

    part: slice
    time_s: Values
    columns: dict[str, Values]
    corrections: tuple[LoggerCorrection, ...]


def prepare_frames(
    words: Words,
    time_s: Values,
    columns: dict[str, Values],
    *,
    first_row: int,
    force: Callable[[], Values] | None = None,
) -> PreparedFrames:
    """Reserved frames at the ends left out; wild, missing and repeated values replaced by lines between their
    neighbours.

    The first column is the place (the jaws' aperture). `force`: how hard it presses, to tell a place that is
    read slowly from one that moves in steps; without it no place is taken for repeated. Raises NotPrepared
    for several recordings one behind the other, and for more than MOST_CORRECTED of spoilt frames.
    """
    rows = first_row + np.arange(len(time_s))
    pressed = {} if force is None or not _looks_reserved(columns) else {"force": force()}
    keep, notes = written(words, time_s, {**columns, **pressed}, rows)
    kept = np.flatnonzero(keep)
    part = slice(int(kept[0]), int(kept[-1]) + 1) if len(kept) else slice(0, len(time_s))
    time, rows = time_s[part], rows[part]
    spans = runs(time)
    if len(spans) > 1:
        begin = ", ".join(str(rows[span.start]) for span in spans)
        raise NotPrepared(
            f"{len(spans)} recordings one behind the other (the time starts again in {words.row}s {begin})",
            "one recording in each file; divide it where the time starts again",
        )
    spoilt = np.zeros(len(time), dtype=bool)
    filled: dict[str, Values] = {}
    places = np.arange(len(time), dtype=float)
    for name, values in [("time", time), *((name, column[part]) for name, column in columns.items())]:
        off = wild_times(values) if name == "time" else wild(values)
        hole = np.isnan(values)
        notes += _replaced(words, name, LoggerFault.WILD, rows, values, off)
        notes += _replaced(words, name, LoggerFault.MISSING, rows, values, hole)
        spoilt |= off | hole
        over = places if name == "time" else filled["time"]
        filled[name] = _between(over, values, off | hole)
    if spoilt.sum() > MOST_CORRECTED * len(time):
        share = f"{int(spoilt.sum())} of {words.count(len(time))} ({spoilt.mean():.1%})"
        raise NotPrepared(
            f"{share} with wild or missing values ({spoilt_said(words, notes)})",
            f"at most {MOST_CORRECTED:.0%}; record again",
        )
    first = next(iter(columns))
    if force is not None and len(time) > 1 and (np.diff(filled[first]) == 0).mean() > 0.3:
        filled[first], again = _without_repeats(words, first, filled, force()[part], rows)
        notes += again
    return PreparedFrames(part=part, time_s=filled.pop("time"), columns=filled, corrections=tuple(notes))


def _looks_reserved(columns: dict[str, Values]) -> bool:
    """Whether the first two or the last two frames hold one place: only then the forces are looked at."""
    place = next(iter(columns.values()))
    return len(place) > 2 and bool(
        place[0] == place[1] or place[-1] == place[-2] or np.isnan(place[[0, -1]]).any()
    )


def _replaced(
    words: Words,
    name: str,
    fault: LoggerFault,
    rows: np.ndarray,
    values: Values,
    which: Bool[np.ndarray, " t"],
) -> list[LoggerCorrection]:
    if not which.any():
        return []
    kind = "wild" if fault is LoggerFault.WILD else "missing"
    many = f"{int(which.sum())} {kind} value{'' if which.sum() == 1 else 's'}"
    says = (
        f"drupe replaced {many} of {name} by interpolation between neighbours: "
        f"{listed(words, name, rows[which], values[which])}."
    )
    return [correction(fault, name, rows[which], values[which], says)]


def _between(over: Values, values: Values, spoilt: Bool[np.ndarray, " t"]) -> Values:
    if not spoilt.any() or spoilt.all():
        return values
    return np.where(spoilt, np.interp(over, over[~spoilt], values[~spoilt]), values)


def _without_repeats(
    words: Words, name: str, filled: dict[str, Values], force: Values, rows: np.ndarray
) -> tuple[Values, list[LoggerCorrection]]:
    """The place on lines between its readings, where it is read more slowly than the frames are taken."""
    values, time = filled[name], filled["time"]
    rhythm = rhythm_of(values, force)
    if rhythm is None:
        return values, []
    readings, period = rhythm
    again = np.ones(len(values), dtype=bool)
    again[readings] = False
    rate = 1 / (period * float(np.median(np.diff(time))))
    count = words.count(int(again.sum()))
    says = (
        f"{name} was read {rate:.3g} times a second and repeated in between; {count} now lie on lines "
        "between the readings."
    )
    note = correction(LoggerFault.REPEATED, name, rows[again], values[again], says)
    return _between(time, values, again), [note]

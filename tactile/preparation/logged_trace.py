"""A force-displacement curve with the logger's faults corrected, and a note on each correction."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.preparation.logger_correction import (
    LoggerCorrection,
    LoggerFault,
    correction,
    counted,
    measured,
    rows_listed,
    spoilt_said,
)
from tactile.preparation.readings import rhythm_of
from tactile.preparation.resets import Ambiguous, resets
from tactile.preparation.rows import Values, runs, unwritten_blocks, unwritten_inside, wild, wild_times
from tactile.readers.pictures import unusable

MOST_CORRECTED = 0.02
"""Share of the rows that may be left out one by one (wild or missing); above it the record is refused."""
JOINED = 0.2
"""Share of the rows that lack one of two quantities, above which they are topics of two rates."""
FEWEST_READINGS = 20
"""Of each topic."""
FEWEST_IN_RUN = 8
"""Rows of the shortest run; fewer are times out of order."""
OVERLAP = 0.5
"""Share of the shorter topic's time that both topics must have in common."""


@dataclass(frozen=True, kw_only=True)
class LoggedTrace:
    """A table's values, with NaN for an empty cell. `travel`: travel or gap (`quantity`); `rows`: their
    numbers in the file `source`; `breaks`: rows (by index) before which the header is repeated.
    """

    time_s: Values
    travel: Values
    force_N: Values
    rows: Int[np.ndarray, " t"]
    quantity: str = "travel"
    breaks: tuple[int, ...] = ()
    source: str = "trace"

    def part(self, keep: Bool[np.ndarray, " t"] | slice | Int[np.ndarray, " k"]) -> "LoggedTrace":
        """Some of the rows, without the breaks."""
        names = ("time_s", "travel", "force_N", "rows")
        return replace(self, **{name: getattr(self, name)[keep] for name in names}, breaks=())

    @property
    def columns(self) -> dict[str, Values]:
        """Travel (or gap) and force by name."""
        return {self.quantity: self.travel, "force": self.force_N}

    @property
    def topics(self) -> list[Bool[np.ndarray, " t"]]:
        """Rows of travel and of force if these are topics of two rates in one table; else none."""
        topics = [np.isfinite(column) for column in self.columns.values()]
        joined = (topics[0] != topics[1]).mean() > JOINED
        return topics if joined and min(topic.sum() for topic in topics) >= FEWEST_READINGS else []


def written_runs(logged: LoggedTrace) -> tuple[list[LoggedTrace], list[LoggerCorrection]]:
    """The successive runs of a table, without rows that were never written.

    Raises TactileFailure (unreadable-frames) if times are out of order (a run shorter than FEWEST_IN_RUN), or
    if the clock was set back.
    """
    keep, notes = written(logged.time_s, logged.columns, logged.rows)
    breaks = np.unique(np.searchsorted(np.flatnonzero(keep), np.array(logged.breaks, dtype=int)))
    left = logged.part(keep)
    inside = breaks[(breaks > 0) & (breaks < len(left.rows))].tolist()
    parts = [left.part(span) for span in runs(left.time_s, inside, of_topics=left.topics)]
    for before, after in pairwise(parts):
        _refuse_disorder(before, after)
    return parts, notes


def _refuse_disorder(before: LoggedTrace, after: LoggedTrace) -> None:
    """Raise if times run back within a few rows, or while travel and force continue."""
    row, last, first = after.rows[0], before.time_s[-1], after.time_s[0]
    back = f"{first:g} s in row {row} after {last:g} s"
    if len(after.rows) < FEWEST_IN_RUN or len(before.rows) < FEWEST_IN_RUN:
        raise unusable(
            after.source, back, "increasing times; leave out the rows whose times are out of order"
        )
    if _goes_on(before, after):
        fault = f"{back}, while {before.quantity} and force go on: the clock was set back"
        raise unusable(after.source, fault, "one clock; add to the times behind it what it was set back by")


def _goes_on(before: LoggedTrace, after: LoggedTrace) -> bool:
    """Whether, under load, travel and force change from one part to the next by no more than about one row's
    step.
    """
    load = np.abs(before.force_N - np.nanmedian(before.force_N[:5]))
    if not load[-1] > 0.1 * np.nanmax(load):
        return False
    for earlier, later in zip(before.columns.values(), after.columns.values(), strict=True):
        steps = np.abs(np.diff(earlier))
        if not abs(later[0] - earlier[-1]) <= 3 * np.nanpercentile(steps, 95):
            return False
    return True


def prepare(logged: LoggedTrace) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """Complete rows of one run with increasing times, and the corrections: of wild times and readings, slow
    or joined readings, missing values, then resets.

    Raises TactileFailure (unreadable-frames) if more than MOST_CORRECTED of the rows would be left out one by
    one, or two topics overlap too little in time. It also raises if times do not increase, or if a step of
    the force may be a reset or the specimen's.
    """
    total, joined = len(logged.rows), bool(logged.topics)
    logged, notes = _without_wild_times(logged)
    if not joined:
        inside = unwritten_inside(list(logged.columns.values()))
        if inside.any():
            says = f"{counted(int(inside.sum()))} inside the record repeat one value; drupe left out all."
            notes.append(
                correction(
                    LoggerFault.MISSING, logged.quantity, logged.rows[inside], logged.travel[inside], says
                )
            )
            logged = logged.part(~inside)
    logged, corrections = _without_wild(logged)
    notes += corrections
    spoilt = {row for note in notes if note.fault is not LoggerFault.REPEATED for row in note.rows}
    if joined:
        logged, note = _on_one_clock(logged)
        notes.append(note)
    else:
        logged, corrections = _on_readings(logged, known=spoilt)
        notes += corrections
        spoilt |= {row for note in corrections if note.fault is LoggerFault.MISSING for row in note.rows}
    if len(spoilt) > MOST_CORRECTED * total:
        share = f"{len(spoilt)} of {total} rows ({len(spoilt) / total:.1%})"
        raise unusable(
            logged.source,
            f"{share} wild or missing ({spoilt_said(notes)})",
            f"at most {MOST_CORRECTED:.0%}; look for the loose contact or the lost data, and press again",
        )
    stands = np.flatnonzero(np.diff(logged.time_s) <= 0)
    if len(stands):
        k = int(stands[0])
        back = f"{logged.time_s[k + 1]:g} s in row {logged.rows[k + 1]} after {logged.time_s[k]:g} s"
        raise unusable(
            logged.source, back, "increasing times; export more decimals of the time, or leave out one row"
        )
    logged, corrections = _without_resets(logged)
    return logged, [*notes, *corrections]


def written(
    time_s: Values, columns: Mapping[str, Values], rows: Int[np.ndarray, " t"]
) -> tuple[Bool[np.ndarray, " t"], list[LoggerCorrection]]:
    """Which rows were written, and a note on each unwritten block at the start or the end."""
    keep, notes = np.ones(len(time_s), dtype=bool), []
    for part in unwritten_blocks(time_s, list(columns.values())):
        keep[part] = False
        held = {name: float(values[part.start]) for name, values in columns.items()}
        whole = not np.isnan(list(held.values())).any()
        kept = ", ".join(f"{name} {measured(name, held[name])}" for name in held)
        count = part.stop - part.start
        why = f"never written ({'all hold' if count > 1 else 'it holds'} {kept})" if whole else "not whole"
        place = "start" if part.start == 0 or not keep[: part.start].any() else "end"
        says = (
            f"{counted(count)} at the {place}, from row {rows[part.start]} on, {why}; drupe left "
            "out all of them."
        )
        notes.append(
            correction(LoggerFault.RESERVED, ", ".join(held), rows[part], np.array(list(held.values())), says)
        )
    return keep, notes


def _without_wild_times(logged: LoggedTrace) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """The record without rows of wild time (judged for each topic) or written twice, topics sorted by
    time."""
    notes, time = [], logged.time_s
    off = np.zeros(len(time), dtype=bool)
    for topic in logged.topics or [~off]:
        off[topic] |= wild_times(time[topic])
    if off.any():
        notes.append(_wild_note("time", logged.rows[off], time[off]))
    twice = np.r_[False, np.diff(time) == 0]
    for column in logged.columns.values():
        twice[1:] &= (np.diff(column) == 0) | (np.isnan(column[1:]) & np.isnan(column[:-1]))
    if twice.any():
        at, times = logged.rows[twice], time[twice]
        says = (
            f"{counted(len(at))} appear twice ({rows_listed('time', at, times)}); drupe left out the repeats."
        )
        notes.append(correction(LoggerFault.REPEATED, "time", at, times, says))
    kept = np.flatnonzero(~(off | twice))
    if logged.topics:
        kept = kept[np.argsort(time[kept], kind="stable")]
    return logged.part(kept), notes


def _without_wild(logged: LoggedTrace) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """Travel and force with NaN for wild values, and the notes."""
    notes, left = [], []
    for name, values in logged.columns.items():
        off = wild(values)
        if off.any():
            notes.append(_wild_note(name, logged.rows[off], values[off]))
        left.append(np.where(off, np.nan, values))
    return replace(logged, travel=left[0], force_N=left[1]), notes


def _wild_note(
    quantity: str, rows: Int[np.ndarray, " k"], values: Float[np.ndarray, " k"]
) -> LoggerCorrection:
    many = "wild reading" if len(rows) == 1 else "wild readings"
    says = f"{len(rows)} {many} of {quantity} left out: {rows_listed(quantity, rows, values)}."
    return correction(LoggerFault.WILD, quantity, rows, values, says)


def _on_readings(logged: LoggedTrace, *, known: set[int]) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """Rows with a time and a new reading of travel and of force; `known`: rows already left out."""
    notes = []
    whole = np.isfinite(logged.travel) & np.isfinite(logged.force_N) & np.isfinite(logged.time_s)
    keep = whole.copy()
    for name, values in logged.columns.items():
        rhythm = rhythm_of(values, logged.travel if name == "force" else logged.force_N)
        if rhythm is None:
            continue
        rows, period = rhythm
        again = np.isfinite(values)
        again[rows] = False
        rate = 1 / (period * float(np.median(np.diff(logged.time_s))))
        says = (
            f"{name} was read {rate:.3g} times a second and repeated in between; drupe used the first "
            f"row of each reading ({counted(int(again.sum()))} of {len(values)} repeat, from row "
            f"{logged.rows[np.argmax(again)]} on)."
        )
        notes.append(correction(LoggerFault.REPEATED, name, logged.rows[again], values[again], says))
        keep &= ~again
    lacking = ~whole & ~np.isin(logged.rows, list(known))
    if lacking.any():
        at = logged.rows[lacking]
        which = ", ".join(f"row {row}" for row in at[:3])
        which += f" and {len(at) - 3} more" if len(at) > 3 else ""
        says = f"{counted(len(at))} with an empty cell left out: {which}."
        notes.append(correction(LoggerFault.MISSING, "", at, np.full(len(at), np.nan), says))
    return logged.part(keep), notes


def _on_one_clock(logged: LoggedTrace) -> tuple[LoggedTrace, LoggerCorrection]:
    """The travel interpolated at the times of the force, where both were read.

    Raises TactileFailure (unreadable-frames) if the two topics have less than OVERLAP in common.
    """
    timed = np.isfinite(logged.time_s)
    parts = [logged.part(np.isfinite(values) & timed) for values in logged.columns.values()]
    (a, b), (c, d) = (part.time_s[[0, -1]] for part in parts)
    name = logged.quantity
    if min(b, d) - max(a, c) < OVERLAP * min(b - a, d - c):
        fault = f"two clocks: {name} from {a:.10g} to {b:.10g} s, force from {c:.10g} to {d:.10g} s"
        raise unusable(
            logged.source, fault, "both on one clock; export them again with one time for all topics"
        )
    m, n = (len(part.rows) for part in parts)
    says = (
        f"{name} ({m} readings, {m / (b - a):.3g} per second) and force ({n} readings, "
        f"{n / (d - c):.3g} per second) are two topics in one table. drupe interpolated {name} at the times "
        "of force."
    )
    note = correction(LoggerFault.JOINED, name, logged.rows[:1], logged.travel[:1], says)
    common = parts[1].part((parts[1].time_s >= a) & (parts[1].time_s <= b))
    travel = np.interp(common.time_s, parts[0].time_s, parts[0].travel)
    return replace(common, travel=travel), note


def _without_resets(logged: LoggedTrace) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """The record with the step of each reset removed."""
    try:
        zero_resets = resets(logged.time_s, logged.travel, logged.force_N)
    except Ambiguous as cause:
        shown = (
            "no frames in air follow"
            if cause.shift_N is None
            else f"it differs by {cause.shift_N:+.3g} N in air afterwards"
        )
        said = (
            f"a force that jumps by {cause.step_N:+.3g} N at row {logged.rows[cause.row]}, and "
            f"{shown}: the load cell was zeroed under load, or the specimen broke"
        )
        wanted = (
            "one zero of the load cell throughout, and frames in air after the press; press again "
            "without zeroing it"
        )
        raise unusable(logged.source, said, wanted) from None
    travel, force, notes = logged.travel.copy(), logged.force_N.copy(), []
    for reset in zero_resets:
        values, name = (force, "force") if reset.quantity == "force" else (travel, logged.quantity)
        values[reset.row :] -= reset.step
        row, step = int(logged.rows[reset.row]), np.array([reset.step])
        what = (
            "the load cell was zeroed under load"
            if name == "force"
            else f"the display of the {name} was zeroed"
        )
        says = (
            f"{what} at row {row} ({measured(name, reset.step)} in one row, while "
            "the other quantity continues); drupe removed the step, on the scale of the rows before "
            "it."
        )
        notes.append(correction(LoggerFault.RESET, name, np.array([row]), step, says))
    return replace(logged, travel=travel, force_N=force), notes

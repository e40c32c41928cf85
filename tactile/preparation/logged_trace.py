"""The trace of a press as the specimen made it: what the logger did is put right, with a note on each."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.preparation.logger_correction import (
    LoggerCorrection,
    LoggerFault,
    Words,
    correction,
    spoilt_said,
)
from tactile.preparation.readings import is_held, on_common_rows, rhythm_of
from tactile.preparation.resets import Ambiguous, resets
from tactile.preparation.structure import (
    FEWEST_IN_RUN,
    reserved_inside,
    runs,
    wild_note,
    wild_or_repeated_times,
    written,
)
from tactile.preparation.wild import of_specimen, wild

Values: TypeAlias = Float[np.ndarray, " t"]

MOST_CORRECTED = 0.02
"""Share of the rows that may be left out one by one (wild or missing): more is a broken record."""
JOINED = 0.2
"""Share of the rows that lack one of two quantities, from which these are topics of two rates."""
FEWEST_READINGS = 20
"""Of each topic."""
OVERLAP = 0.5
"""Share of the shorter topic's time that both topics must have in common."""


class NotPrepared(Exception):
    """A record that no step puts right: `fault` and `expected` as a reader's sentence needs them."""

    def __init__(self, fault: str, expected: str) -> None:
        super().__init__(fault, expected)
        self.fault, self.expected = fault, expected


@dataclass(frozen=True, kw_only=True)
class LoggedTrace:
    """What a table holds: NaN for an empty cell. `travel`: or the gap (`quantity`); `rows`: numbers in the
    file; `breaks`: rows (by index) before which the header stands again.
    """

    time_s: Values
    travel: Values
    force_N: Values
    rows: Int[np.ndarray, " t"]
    quantity: str = "travel"
    breaks: tuple[int, ...] = ()

    def part(self, keep: Bool[np.ndarray, " t"] | slice | Int[np.ndarray, " k"]) -> "LoggedTrace":
        """Some of the rows, without the breaks."""
        return LoggedTrace(
            time_s=self.time_s[keep],
            travel=self.travel[keep],
            force_N=self.force_N[keep],
            rows=self.rows[keep],
            quantity=self.quantity,
        )

    @property
    def columns(self) -> dict[str, Values]:
        """Travel (or gap) and force by name."""
        return {self.quantity: self.travel, "force": self.force_N}


@dataclass(frozen=True, kw_only=True)
class PreparedTrace:
    """Rows that hold all three quantities, of increasing times, and what was done."""

    logged: LoggedTrace
    corrections: tuple[LoggerCorrection, ...]


def written_runs(logged: LoggedTrace) -> tuple[list[LoggedTrace], list[LoggerCorrection]]:
    """The runs that stand one below the other, without rows that were never written.

    Raises NotPrepared for times that are out of order all over, and for a clock that was set back.
    """
    words = Words()
    keep, notes = written(words, logged.time_s, logged.columns, logged.rows)
    at = np.flatnonzero(keep)
    breaks = np.unique(np.searchsorted(at, np.array(logged.breaks, dtype=int))).tolist()
    left = logged.part(keep)
    spans = runs(left.time_s, [k for k in breaks if 0 < k < len(at)], of_topics=_topics(left))
    parts = [left.part(span) for span in spans]
    for before, after in pairwise(parts):
        _refuse_disorder(before, after)
    return parts, notes


def _refuse_disorder(before: LoggedTrace, after: LoggedTrace) -> None:
    """Times that run back in a few rows, or while travel and force go on."""
    row, last, first = after.rows[0], before.time_s[-1], after.time_s[0]
    back = f"{first:g} s in row {row} after {last:g} s"
    if len(after.rows) < FEWEST_IN_RUN or len(before.rows) < FEWEST_IN_RUN:
        raise NotPrepared(back, "increasing times; leave out the rows whose times are out of order")
    if _goes_on(before, after):
        fault = f"{back}, while {before.quantity} and force go on: the clock was set back"
        raise NotPrepared(fault, "one clock; add to the times behind it what it was set back by")


def _goes_on(before: LoggedTrace, after: LoggedTrace) -> bool:
    """Whether travel and force change from one part to the next by no more than they do in one row, under
    load.
    """
    load = np.abs(before.force_N - np.nanmedian(before.force_N[:5]))
    if not load[-1] > 0.1 * np.nanmax(load):
        return False
    for earlier, later in zip(before.columns.values(), after.columns.values(), strict=True):
        steps = np.abs(np.diff(earlier))
        if not abs(later[0] - earlier[-1]) <= 3 * np.nanpercentile(steps, 95):
            return False
    return True


def prepare(logged: LoggedTrace) -> PreparedTrace:
    """One run, prepared: wild times and readings, slow or joined readings, missing values, then resets.

    Raises NotPrepared where more than MOST_CORRECTED of the rows would be left out one by one, two topics
    have no time in common, times stand still, or a step of the force may be a reset or the specimen's.
    """
    words, total = Words(), len(logged.rows)
    leave, notes = wild_or_repeated_times(
        words, logged.time_s, logged.columns, logged.rows, of_topics=_topics(logged)
    )
    if _is_joined(logged):  # rows in the order of time, which of two topics one below the other they are not
        order = np.argsort(logged.time_s, kind="stable")
        logged, leave = logged.part(order), leave[order]
    logged = logged.part(~leave)
    spoilt: set[int] = {row for note in notes if note.fault is LoggerFault.WILD for row in note.rows}
    inside = reserved_inside(list(logged.columns.values())) if not _is_joined(logged) else None
    if inside is not None and inside.any():
        says = f"{words.count(int(inside.sum()))} inside the record repeat one value; drupe left out all."
        notes.append(
            correction(LoggerFault.MISSING, logged.quantity, logged.rows[inside], logged.travel[inside], says)
        )
        spoilt |= set(logged.rows[inside].tolist())
        logged = logged.part(~inside)
    travel, force, corrections = _without_wild(words, logged)
    notes += corrections
    spoilt |= {row for repair in corrections for row in repair.rows}
    logged = replace(logged, travel=travel, force_N=force)
    logged, corrections = _on_readings(words, logged, known=spoilt)
    notes += corrections
    spoilt |= {row for repair in corrections if repair.fault is LoggerFault.MISSING for row in repair.rows}
    if len(spoilt) > MOST_CORRECTED * total:
        share = f"{len(spoilt)} of {total} rows ({len(spoilt) / total:.1%})"
        raise NotPrepared(
            f"{share} wild or missing ({spoilt_said(words, notes)})",
            f"at most {MOST_CORRECTED:.0%}; look for the loose contact or the lost data, and press again",
        )
    stands = np.flatnonzero(np.diff(logged.time_s) <= 0)
    if len(stands):
        k = int(stands[0])
        back = f"{logged.time_s[k + 1]:g} s in row {logged.rows[k + 1]} after {logged.time_s[k]:g} s"
        raise NotPrepared(back, "increasing times; export more decimals of the time, or leave out one row")
    logged, corrections = _without_resets(words, logged)
    return PreparedTrace(logged=logged, corrections=(*notes, *corrections))


def _topics(logged: LoggedTrace) -> list[Bool[np.ndarray, " t"]]:
    """Rows of each topic, where two are joined."""
    return [np.isfinite(column) for column in logged.columns.values()] if _is_joined(logged) else []


def _is_joined(logged: LoggedTrace) -> bool:
    """Whether travel and force are topics of two rates in one table."""
    travel, force = np.isfinite(logged.travel), np.isfinite(logged.force_N)
    apart = (travel != force).mean() > JOINED
    return bool(apart and min(travel.sum(), force.sum()) >= FEWEST_READINGS)


def _without_wild(words: Words, logged: LoggedTrace) -> tuple[Values, Values, list[LoggerCorrection]]:
    """Travel and force with NaN for what is wild, and the notes."""
    columns, notes = [], []
    for name, values in logged.columns.items():
        other = logged.travel if name == "force" else logged.force_N
        off = wild(values)
        off &= ~of_specimen(off, values, other, of_force=name == "force")
        if off.any():
            notes.append(wild_note(words, name, logged.rows[off], values[off]))
        columns.append(np.where(off, np.nan, values))
    return columns[0], columns[1], notes


def _on_readings(
    words: Words, logged: LoggedTrace, *, known: set[int]
) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """Rows that hold a reading of travel and of force; `known`: rows left out already."""
    notes = []
    joined = _is_joined(logged)
    travel, force = logged.travel.copy(), logged.force_N.copy()
    for values, other, name in ((travel, force, logged.quantity), (force, travel, "force")):
        rhythm, equal = rhythm_of(values, other)
        if rhythm is None or joined:
            continue
        if equal and (name == "force" or not is_held(values, other, rhythm)):
            continue
        again = np.ones(len(values), dtype=bool)
        again[rhythm.rows] = False
        again &= np.isfinite(values)
        rate = 1 / (rhythm.period * float(np.median(np.diff(logged.time_s))))
        says = (
            f"{name} was read {rate:.3g} times a second and repeated in between; drupe used the first "
            f"row of each reading ({words.count(int(again.sum()))} of {len(values)} repeat, from row "
            f"{logged.rows[np.argmax(again)]} on)."
        )
        notes.append(correction(LoggerFault.REPEATED, name, logged.rows[again], values[again], says))
        values[again] = np.nan
    if joined:
        notes.append(_joined_note(logged))
    lacking = np.isnan(logged.travel) | np.isnan(logged.force_N) | np.isnan(logged.time_s)
    lacking &= ~np.isin(logged.rows, list(known))
    if lacking.any() and not joined:
        at = logged.rows[lacking]
        which = ", ".join(f"{words.row} {row}" for row in at[:3]) + (
            f" and {len(at) - 3} more" if len(at) > 3 else ""
        )
        says = f"{words.count(len(at))} with an empty cell left out: {which}."
        notes.append(correction(LoggerFault.MISSING, "", at, np.full(len(at), np.nan), says))
    timed = np.isfinite(logged.time_s)
    rows, there = on_common_rows(logged.time_s[timed], travel[timed], force[timed])
    at = np.flatnonzero(timed)[rows]
    return replace(logged.part(at), travel=there, force_N=force[at]), notes


def _joined_note(logged: LoggedTrace) -> LoggerCorrection:
    """That two topics were put on one clock; raises NotPrepared where they have no time in common."""
    ranges = []
    for name, values in logged.columns.items():
        time = logged.time_s[np.isfinite(values)]
        ranges.append((name, len(time), float(time[0]), float(time[-1])))
    (first_topic, n, a, b), (second_topic, m, c, d) = ranges
    if min(b, d) - max(a, c) < OVERLAP * min(b - a, d - c):
        fault = (
            f"two clocks: {first_topic} from {a:.10g} to {b:.10g} s, "
            f"{second_topic} from {c:.10g} to {d:.10g} s"
        )
        raise NotPrepared(fault, "both on one clock; export them again with one time for all topics")
    says = (
        f"{first_topic} ({n} readings, {n / (b - a):.3g} per second) and {second_topic} ({m} readings, "
        f"{m / (d - c):.3g} per second) are two topics in one table. drupe interpolated {first_topic} at the "
        f"times of {second_topic}, where its readings determine it."
    )
    return correction(LoggerFault.JOINED, first_topic, logged.rows[:1], logged.travel[:1], says)


def _without_resets(words: Words, logged: LoggedTrace) -> tuple[LoggedTrace, list[LoggerCorrection]]:
    """Both parts of each reset on the scale of the first."""
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
        raise NotPrepared(said, wanted) from None
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
            f"{what} at {words.row} {row} ({words.value(name, reset.step)} in one {words.row}, while "
            "the other quantity continues); drupe removed the step, on the scale of the rows before "
            "it."
        )
        notes.append(correction(LoggerFault.RESET, name, np.array([row]), step, says))
    return replace(logged, travel=travel, force_N=force), notes

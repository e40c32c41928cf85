"""What `drupe history` prints."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pipeline.files.plain_file import printable
from pipeline.history.keeping import HistoryMade
from reports.history_entries import SeriesEntry


def summary_lines(made: HistoryMade, written: Sequence[Path]) -> Iterator[str]:
    """Lots first, then what calls for somebody, then what was fitted and written."""
    entry = made.entry
    batches = _counted(entry.batches, "batch", "batches")
    yield f"{batches} ({made.new} new), {_counted(len(entry.series), 'lot', 'lots')}"
    for one in entry.series:
        yield from _series_lines(one)
    for alarm in entry.alarms:
        yield f"reference body {printable(alarm)}"
    yield from map(printable, made.said)
    for path in written:
        yield f"written: {path}"


def _series_lines(one: SeriesEntry) -> Iterator[str]:
    last = one.days[-1]
    yield (
        f"{printable(one.name)}: {_counted(len(one.days), 'day', 'days')}, {last.fruit} fruit on {last.day}, "
        f"E {last.E_MPa:.3g} MPa ({last.E_low_MPa:.3g} to {last.E_high_MPa:.3g})"
    )
    yield f"  {one.softening.words if one.softening else one.why_no_softening + '.'}"
    for limit in one.limits:
        yield f"  {printable(limit.name)} (up to {limit.E_max_MPa:g} MPa): {limit.words}"
    for note in one.notes:
        yield f"  note: {printable(note)}."


def _counted(count: int, one: str, more: str) -> str:
    return f"{count} {one if count == 1 else more}"

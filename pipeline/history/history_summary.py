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
    for series in entry.series:
        yield from _series_lines(series)
    for group in entry.groups:
        yield f"{printable(group.name)}, {len(group.series)} lots: {printable(group.words)}"
    yield from map(printable, entry.comparisons)
    for alarm in entry.alarms:
        yield f"reference body {printable(alarm)}"
    yield from map(printable, made.said)
    for path in written:
        yield f"written: {path}"


def _series_lines(series: SeriesEntry) -> Iterator[str]:
    last = series.days[-1]
    days = _counted(len(series.days), "day", "days")
    yield (
        f"{printable(series.name)}: {days}, {last.fruit} fruit on {last.day}, "
        f"E {last.E_MPa:.3g} MPa ({last.E_low_MPa:.3g} to {last.E_high_MPa:.3g})"
    )
    yield f"  {series.softening.words if series.softening else series.why_no_softening + '.'}"
    for limit in series.limits:
        yield f"  {printable(limit.name)} (up to {limit.E_max_MPa:g} MPa): {limit.words}"
        yield f"    10 % of the fruit: {limit.tenth_words}"
    for note in series.notes:
        yield f"  note: {printable(note)}."


def _counted(count: int, singular: str, more: str) -> str:
    return f"{count} {singular if count == 1 else more}"

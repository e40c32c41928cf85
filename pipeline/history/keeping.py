"""`drupe history`: reads results of many days, stores them, and writes a page and tables."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from pipeline.batch.write_guard import require_file_apart, require_new_or_ours
from pipeline.files.plain_file import printable, text_or_empty
from pipeline.files.whole_file import put
from pipeline.history.acceptance_plans import OC_COLUMNS
from pipeline.history.appraisers import APPRAISERS, gauge_entry
from pipeline.history.firmness_relation import with_firmness
from pipeline.history.history_table import COLUMNS, STATISTICS_COLUMNS, fruit_table, statistics_table
from pipeline.history.lot_database import history_store
from pipeline.history.lot_history import PRECISION, history_entry
from pipeline.history.lot_quality import QualityWanted, characteristics, lots_quality, quality_lines
from pipeline.history.stored_batch import stored_batch
from pipeline.history.table_file import put_table, require_format, table_of
from pipeline.problem import refused
from reports.history_entries import GaugeEntry, HistoryEntry, SeriesEntry
from reports.history_page import history_html, page_titles
from reports.language import ENGLISH
from reports.words import lot_words

COMMAND = "drupe history"
MOST_BYTES = 100_000_000
"""Largest page that drupe reads before it replaces it: ten thousand batches."""


@dataclass(frozen=True, kw_only=True)
class HistoryWanted:
    """Options of `drupe history`. `forget`: batches, lots or fruit to remove from the store. `export`: table
    of fruit. `statistics`: table of lots, with the fruit that their means need for `precision` (a share).
    `gauge`: "gripper", "sensor" or both. `oc`: table of operating characteristics of sampling plans.
    `language`: of the page.
    """

    store: Path | None = None
    html: Path | None = None
    language: str = ENGLISH
    export: Path | None = None
    statistics: Path | None = None
    precision: float = PRECISION
    gauge: tuple[str, ...] = ()
    forget: tuple[str, ...] = ()
    oc: Path | None = None
    quality: QualityWanted = field(default_factory=QualityWanted)


@dataclass(frozen=True, kw_only=True)
class HistoryMade:
    """The page's entry, the number of new batches, and sentences on studies and plans."""

    entry: HistoryEntry
    new: int
    said: tuple[str, ...]


def make_history(outs: Sequence[Path], wanted: HistoryWanted, *, now: datetime) -> HistoryMade:
    """Reads the results, adds them to the store, and writes the wanted files.

    Raises BatchRefused, before it writes a file, for unreadable results or store, invalid options, or a
    target that drupe must not overwrite. Raises NotWritten.
    """
    _require_valid_options(outs, wanted)
    added = [stored_batch(out) for out in outs]
    with history_store(wanted.store) as store:
        new = sum([store.add(batch) for batch in added])
        batches = store.batches()
        if not batches:
            raise refused(str(wanted.store or COMMAND), "contains no batch yet; name results folders.")
        studies = [gauge_entry(batches, kind) for kind in wanted.gauge]
        quality, relations = lots_quality(batches, wanted.quality)
        entry = history_entry(
            batches,
            gauges=[study for study in studies if isinstance(study, GaugeEntry)],
            precision=wanted.precision,
            now=now,
        )
        entry = replace(entry, quality=quality)
    if wanted.export is not None:
        put_table(wanted.export, with_firmness(fruit_table(batches), batches, relations))
    if wanted.statistics is not None:
        put_table(wanted.statistics, statistics_table(batches, precision=wanted.precision))
    if wanted.oc is not None:
        put_table(wanted.oc, characteristics(quality))
    if wanted.html is not None:
        put(wanted.html, history_html(entry, language=wanted.language).encode())
    said = [f"{study}." if isinstance(study, str) else f"{study.words}." for study in studies]
    said += quality_lines(quality)
    return HistoryMade(entry=entry, new=new, said=tuple(said))


def forget_named(outs: Sequence[Path], wanted: HistoryWanted, *, dry_run: bool) -> list[str]:
    """Removes batches, lots or fruit from the store alone; returns a line per batch. With `dry_run` the store
    does not change. Raises BatchRefused for an unknown name, or options that --forget does not allow.
    """
    if not wanted.forget:
        raise refused(COMMAND, "--dry-run shows the effect of --forget; add --forget.")
    pages = wanted.html or wanted.export or wanted.statistics or wanted.oc
    if outs or pages or wanted.quality != QualityWanted():
        raise refused(COMMAND, "--forget allows only --store and --dry-run; write page and table afterwards.")
    if wanted.store is None or not wanted.store.exists():
        raise refused(str(wanted.store or COMMAND), "--forget needs a store; name it with --store.")
    with history_store(wanted.store, damaged_too=True, read_only=dry_run) as store:
        lines = [line for named in wanted.forget for line in store.forget(named)]
    return [f"{'would forget' if dry_run else 'forgotten'}: {line}" for line in lines]


def _require_valid_options(outs: Sequence[Path], wanted: HistoryWanted) -> None:
    if not outs and wanted.store is None:
        raise refused(COMMAND, "needs results folders, or a store with --store.")
    if unknown := [kind for kind in wanted.gauge if kind not in APPRAISERS]:
        raise refused(COMMAND, f'--gauge: found "{unknown[0]}", expected {" or ".join(APPRAISERS)}.')
    if not 0 < wanted.precision <= 1:
        percent = f"{100 * wanted.precision:g}"
        raise refused(COMMAND, f"--precision: found {percent}, expected per cent of the mean, 0 to 100.")
    if wanted.oc is not None and not wanted.quality.accept:
        raise refused(COMMAND, "--oc writes the curve of a sampling plan; add --accept CLASS.")
    for table, option in (
        (wanted.export, "--export"),
        (wanted.statistics, "--statistics"),
        (wanted.oc, "--oc"),
    ):
        if table is not None:
            require_format(table, option)
    if wanted.store is not None:
        require_file_apart(wanted.store, inputs=[], folders=outs)
    for target, is_ours, what in (
        (wanted.html, _is_page, "a page of drupe history"),
        (wanted.export, table_of(COLUMNS), "a table of drupe history --export"),
        (wanted.statistics, table_of(STATISTICS_COLUMNS), "a table of drupe history --statistics"),
        (wanted.oc, table_of(OC_COLUMNS[:2]), "a table of drupe history --oc"),
    ):
        if target is None:
            continue
        if not target.absolute().parent.is_dir():
            raise refused(target.parent, "does not exist; create the folder first.")
        require_file_apart(target, inputs=[wanted.store] if wanted.store else [], folders=outs)
        require_new_or_ours(target, is_ours, what)


def _is_page(path: Path) -> bool:
    head = text_or_empty(path, most_bytes=MOST_BYTES)[:2000]
    return any(title in head for title in page_titles())


def summary_lines(made: HistoryMade, written: Sequence[Path]) -> Iterator[str]:
    """Lines for the terminal: lots, comparisons, alarms, studies and plans, then the written files."""
    entry = made.entry
    batches = _counted(entry.batches, "batch", "batches")
    yield f"{batches} ({made.new} new), {_counted(len(entry.series), 'lot', 'lots')}"
    for series in entry.series:
        yield from _series_lines(series)
    for group in entry.groups:
        yield f"{printable(lot_words(group.name))}, {len(group.series)} lots: {printable(group.words)}"
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
        f"{printable(lot_words(series.name))}: {days}, {last.fruit} fruit on {last.day}, "
        f"geometric mean of E {last.E_MPa:.3g} MPa ({last.E_low_MPa:.3g} to {last.E_high_MPa:.3g}, 90 %)"
    )
    yield f"  {series.softening_words}"
    for limit in series.limits:
        yield f"  {printable(limit.name)} (up to {limit.E_max_MPa:g} MPa): {limit.words}"
        yield f"    10 % of the fruit: {limit.tenth_words}"
    for note in series.notes:
        yield f"  note: {printable(note)}."


def _counted(count: int, singular: str, more: str) -> str:
    return f"{count} {singular if count == 1 else more}"

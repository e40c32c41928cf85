"""Ranking and report of a run: at its end, while it goes on, and again from its records (`drupe report`)."""

import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import BatchFolder, Results, write_whole
from pipeline.batch.opening import open_batch, unlisted_fruit
from pipeline.batch.provenance import require_provenance
from pipeline.batch.records import FruitRecord, read_record, write_changed
from pipeline.batch.write_guard import results_lock
from pipeline.exit_status import DONE, DOUBTED, INTERRUPTED, UNUSABLE
from pipeline.files.plain_file import printable
from pipeline.files.whole_file import NotWritten
from pipeline.fruit.recording_owner import copies_doubted
from pipeline.problem import BatchRefused, refused
from pipeline.ranking.batch_faults import batch_faults
from pipeline.ranking.reference_ratio import ReferenceFinding, as_measured
from pipeline.ranking.reference_temperature import compared
from pipeline.ranking.report_entries import batch_entry
from pipeline.run.batch_run import BatchRun, GradeOptions
from reports.entries import BatchEntry, Unfinished
from reports.page import report_html
from reports.tables import ranking_csv, ranking_json

LEAST_S = 2.0
"""Least seconds between two reports of a run in progress. Set by hand: nobody reads faster."""
SHARE = 0.01
"""Most of the run's time that reports may take: after a report that took t, the next waits t / SHARE."""


def report(run: BatchRun, records: MutableMapping[str, FruitRecord]) -> tuple[int, BatchEntry]:
    """Compares the fruit with each other and the reference bodies; writes ranking, report and provenance.

    Returns the exit status and the content of the report; updates `records` as those on disk. Raises
    NotWritten.
    """
    settings = run.batch.settings
    measured = [records[row.fruit_id] for row in run.batch.rows]
    in_order, finding = compared(copies_doubted(measured, run.batch.folder), settings)
    records.update(_keep_comparisons(measured, in_order, run.results))
    faults = batch_faults(in_order)
    status = _status(in_order, finding)
    entry = entry_of(run)(in_order, exit_status=status, finding=finding, faults=faults)
    _write(entry, run)
    run.write_provenance(outcomes_of(records), status, finding, faults)
    return status, entry


def outcomes_of(records: Mapping[str, FruitRecord]) -> dict[str, str]:
    """The outcome of each fruit."""
    return {fruit_id: record.outcome for fruit_id, record in records.items()}


class ReportPace:
    """When a run in progress reports: at least LEAST_S after the last report, and so rarely that
    reports take at most SHARE of its time. `clock`: in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._ended_s, self._took_s = -float("inf"), 0.0

    def due(self) -> bool:
        """Whether the next report is due; true before the first."""
        return self._clock() - self._ended_s >= max(LEAST_S, self._took_s / SHARE)

    @contextmanager
    def reporting(self) -> Iterator[None]:
        """Measures the report that the caller makes inside the block."""
        began = self._clock()
        try:
            yield
        finally:
            self._ended_s = self._clock()
            self._took_s = self._ended_s - began


def report_so_far(
    run: BatchRun, records: Mapping[str, FruitRecord], *, interrupted: bool = False
) -> BatchEntry | None:
    """Replaces ranking and report by those of the finished fruit; returns their content, None without fruit.

    It ignores a failure to write: the end of the run writes again, and reports the failure.
    """
    measured = [records[row.fruit_id] for row in run.batch.rows if row.fruit_id in records]
    if not measured:
        return None
    unfinished = Unfinished(done=len(measured), total=len(run.batch.rows), interrupted=interrupted)
    in_order, finding = compared(copies_doubted(measured, run.batch.folder), run.batch.settings)
    faults = batch_faults(in_order)
    entry = entry_of(run)(in_order, exit_status=None, finding=finding, faults=faults, unfinished=unfinished)
    with suppress(NotWritten):
        _write(entry, run)
    return entry


def report_of_records(
    run: BatchRun, records: MutableMapping[str, FruitRecord]
) -> tuple[int, BatchEntry | None]:
    """`report` of a run that grades no fruit. If some fruit have no record, returns INTERRUPTED, and the
    content of ranking and report of the others (None without any). Both state that fruit are missing;
    batch.json stays.
    """
    if all(row.fruit_id in records for row in run.batch.rows):
        return report(run, records)
    return INTERRUPTED, report_so_far(run, records, interrupted=True)


def entry_of(run: BatchRun) -> partial[BatchEntry]:
    """`batch_entry` with what every report of the run shares: batch, places, inputs and times."""
    return partial(
        batch_entry,
        run.batch,
        results=run.results,
        inputs=run.inputs,
        started=run.started,
        finished=run.until_now(),
    )


def _write(entry: BatchEntry, run: BatchRun) -> None:
    write_whole(run.results.ranking, ranking_csv(entry))
    write_whole(run.results.ranking_json, ranking_json(entry))
    write_whole(run.results.report, report_html(entry, language=run.options.language))


def _status(records: Sequence[FruitRecord], finding: ReferenceFinding | None) -> int:
    """The exit status of a finished run; not 0 if staff must inspect something."""
    if not all(record.graded for record in records):
        return UNUSABLE
    alarm = finding is not None and finding.alarm
    return DOUBTED if alarm or any(record.doubts for record in records) else DONE


def _keep_comparisons(
    measured: Sequence[FruitRecord], in_order: Sequence[FruitRecord], results: Results
) -> dict[str, FruitRecord]:
    """Writes the comparison with reference bodies and the copies of recordings into every record.json, beside
    the measured values. Returns the records as stored.
    """
    kept = {}
    for record, reported in zip(measured, in_order, strict=True):
        now = as_measured(record, reported).with_doubts("copied", reported.copied)
        kept[record.fruit_id] = write_changed(results.fruit(record.fruit_id).record, record, now)
    return kept


def report_again(out: Path, batch: Path | None, *, language: str) -> BatchEntry | None:
    """Writes ranking and report of the records in `out`, by the present batch.toml; returns their content.

    `batch`: the batch's folder, if it moved since grading. None if fruit are missing, which the page states.
    Raises BatchRefused if there is nothing to report, and NotWritten.
    """
    results = Results(out)
    said = require_provenance(results)
    root = batch or Path(str(said.get("batch", "")))
    if not BatchFolder(root).settings.is_file():
        sentence = (
            f"belongs to the batch {printable(str(root))}, which does not exist; give the batch with --batch."
        )
        raise refused(results.provenance, sentence)
    opened = open_batch(root, force=True, choose=partial(_with_records, results))
    started, ended = _times(said, results)
    run = BatchRun(
        batch=opened,
        results=results,
        inputs=_hashes(said),
        options=GradeOptions(
            force=bool(said.get("force")), screen=bool(said.get("screened", True)), language=language
        ),
        started=started,
        since_s=time.monotonic(),
        ended=ended,
    )
    with results_lock(out):
        run.require_ours()
        records: dict[str, FruitRecord] = {}
        for row in opened.rows:
            path = results.fruit(row.fruit_id).record
            if (record := read_record(path)) is not None:
                records[row.fruit_id] = _as_noted_now(record, row, path)
        if not records:
            raise refused(out, "contains no fruit's record; run `drupe grade` first.")
        status, entry = report_of_records(run, records)
        return None if status == INTERRUPTED else entry


def with_report(out: Path, batch: Path | None, *, language: str) -> Iterator[str]:
    """Writes ranking and report again; yields a sentence for each reason that prevents it."""
    try:
        report_again(out, batch, language=language)
    except BatchRefused as refusal:
        for problem in refusal.problems:
            yield f"the report does not show it yet: {problem}"


def _with_records(results: Results, folder: BatchFolder, rows: tuple[FruitRow, ...]) -> tuple[FruitRow, ...]:
    """The rows, and a row for each unlisted folder that `drupe watch` has graded."""
    watched = [row for row in unlisted_fruit(folder, rows) if results.fruit(row.fruit_id).record.is_file()]
    return (*rows, *watched)


def _as_noted_now(record: FruitRecord, row: FruitRow, path: Path) -> FruitRecord:
    """The record with the present notes and user's columns of fruits.csv; written if changed."""
    given = record.given.model_copy(update={"notes": row.notes, "columns": row.columns})
    return write_changed(path, record, record.model_copy(update={"given": given}))


def _times(said: Mapping[str, Any], results: Results) -> tuple[datetime, datetime]:
    try:
        started = datetime.fromisoformat(said["started_utc"])
        return started, datetime.fromisoformat(said.get("finished_utc") or said["started_utc"])
    except (KeyError, TypeError, ValueError):
        sentence = "contains no readable times; run `drupe grade` again."
        raise refused(results.provenance, sentence) from None


def _hashes(said: Mapping[str, Any]) -> dict[str, str]:
    inputs = said.get("inputs")
    return {str(k): str(v) for k, v in inputs.items()} if isinstance(inputs, dict) else {}

"""Ranking and report of a run: at its end, and of what is done while it goes on."""

import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial

from pipeline.batch.layout import Results, write_whole
from pipeline.batch.records import FruitRecord, read_record, write_record
from pipeline.exit_status import DONE, DOUBTED, INTERRUPTED, UNUSABLE
from pipeline.files.whole_file import NotWritten
from pipeline.fruit.same_recording import copies_doubted, with_copies
from pipeline.ranking.batch_faults import batch_faults
from pipeline.ranking.reference_ratio import ReferenceFinding, as_measured
from pipeline.ranking.reference_temperature import compared
from pipeline.ranking.report_entries import batch_entry
from pipeline.run.batch_run import BatchRun
from reports.entries import BatchEntry, Unfinished
from reports.page import report_html
from reports.tables import ranking_csv, ranking_json

LEAST_S = 2.0
"""Seconds between two reports of a run that goes on, at least. Set by hand: nobody reads faster."""
SHARE = 0.01
"""Of the run's time that reports may take while it goes on: after one that took t, t over this is waited."""


def report(run: BatchRun, records: MutableMapping[str, FruitRecord]) -> tuple[int, BatchEntry]:
    """Fruit held against each other and the reference bodies; ranking, report and provenance written.

    The exit status and what the report says; `records` are brought up to date as those on disk are. Raises
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
    outcomes = {record.fruit_id: record.outcome for record in measured}
    run.write_provenance(outcomes, status, finding, faults)
    return status, entry


class ReportPace:
    """When a run that goes on reports again: at the earliest LEAST_S after the last report, and so seldom
    that reports take no more than SHARE of its time. `clock` in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._ended_s, self._took_s = -float("inf"), 0.0

    def due(self) -> bool:
        """Whether the last report is far enough back; true before the first."""
        return self._clock() - self._ended_s >= max(LEAST_S, self._took_s / SHARE)

    @contextmanager
    def reporting(self) -> Iterator[None]:
        """A report is made inside the block."""
        began = self._clock()
        try:
            yield
        finally:
            self._ended_s = self._clock()
            self._took_s = self._ended_s - began


class ReportSoFar:
    """ranking.csv and report.html of the fruit that are done, from the first one on, while a run goes on.

    They are replaced as a whole. A run with nothing to do writes none. What cannot be written now is left to
    the end of the run, which says so.
    """

    def __init__(
        self,
        run: BatchRun,
        records: Mapping[str, FruitRecord],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run, self._records, self._pace = run, records, ReportPace(clock)

    def write_when_due(self) -> None:
        """Writes unless the last report is too near, or all fruit are done, which the end writes."""
        if self._pace.due() and len(self._records) < len(self._run.batch.rows):
            self.write()

    def write(self, *, interrupted: bool = False) -> BatchEntry | None:
        """Writes the report of the records there are; what it says, None where there are none."""
        with self._pace.reporting():
            return self._write(interrupted=interrupted)

    def _write(self, *, interrupted: bool) -> BatchEntry | None:
        run = self._run
        measured = [self._records[row.fruit_id] for row in run.batch.rows if row.fruit_id in self._records]
        if not measured:
            return None
        in_order, finding = compared(copies_doubted(measured, run.batch.folder), run.batch.settings)
        entry = entry_of(run)(
            in_order,
            exit_status=None,
            finding=finding,
            faults=batch_faults(in_order),
            unfinished=Unfinished(done=len(measured), total=len(run.batch.rows), interrupted=interrupted),
        )
        with suppress(NotWritten):
            _write(entry, run)
        return entry


def report_of_records(
    run: BatchRun, records: MutableMapping[str, FruitRecord]
) -> tuple[int, BatchEntry | None]:
    """`report` of a run that works on no fruit. Where some have no record: INTERRUPTED, and what ranking and
    report of the others say, which tell that they are not all (None: there are no others). batch.json is left
    as it is.
    """
    if all(row.fruit_id in records for row in run.batch.rows):
        return report(run, records)
    return INTERRUPTED, ReportSoFar(run, records).write(interrupted=True)


def entry_of(run: BatchRun) -> partial[BatchEntry]:
    """`batch_entry` with what every report of the run has: batch, places, inputs and times."""
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
    write_whole(run.results.report, report_html(entry, language=run.language))


def _status(records: Sequence[FruitRecord], finding: ReferenceFinding | None) -> int:
    """The exit status of a run that went to its end; what staff must look into is no 0."""
    if not all(record.graded for record in records):
        return UNUSABLE
    alarm = finding is not None and finding.alarm
    return DOUBTED if alarm or any(record.doubts for record in records) else DONE


def _keep_comparisons(
    measured: Sequence[FruitRecord], in_order: Sequence[FruitRecord], results: Results
) -> dict[str, FruitRecord]:
    """Writes into every record.json what the reference bodies make of its fruit, and which of its recordings
    other fruit have too, beside what was measured. The records of those that said otherwise, as they are now.
    """
    kept = {}
    for record, compared_record in zip(measured, in_order, strict=True):
        if with_copies(as_measured(record, compared_record), compared_record.copied) != record:
            path = results.fruit(record.fruit_id).record
            whole = read_record(path) or record
            kept[record.fruit_id] = with_copies(as_measured(whole, compared_record), compared_record.copied)
            write_record(path, kept[record.fruit_id])
    return kept

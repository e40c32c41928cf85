"""`drupe grade`: every fruit of a batch to its modulus, and the batch to a ranking and a report."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from pipeline.alone import alone
from pipeline.batch import Batch, open_batch, own_files
from pipeline.layout import Results, write_whole
from pipeline.outcome import Outcome
from pipeline.progress import BatchProgress
from pipeline.provenance import input_hashes, write_provenance
from pipeline.records import FruitRecord, read_record, write_record
from pipeline.report import batch_entry
from pipeline.runner import Died, Event, Finished, Progressed, TimedOut, run_fruits
from pipeline.stages import grade_fruit
from pipeline.summary import decimals
from pipeline.task import FruitTask, fruit_task
from reports.entries import BatchEntry
from reports.page import report_html
from reports.tables import ranking_csv

ALL_GRADED, SOME_NOT_GRADED, INTERRUPTED = 0, 3, 130
RETRIED = frozenset(
    outcome.code for outcome in (Outcome.CRASHED, Outcome.TIMED_OUT, Outcome.OUT_OF_MEMORY, Outcome.INTERNAL)
)
"""Endings that may come out otherwise when tried again; every other ending is the inputs' own."""


def utc_now() -> datetime:
    """The present moment, aware."""
    return datetime.now(UTC)


def grade(
    root: Path,
    out: Path | None,
    *,
    jobs: int,
    time_limit_s: float,
    console: Console,
    now: Callable[[], datetime] = utc_now,
) -> tuple[int, BatchEntry]:
    """Grades the batch at `root` into `out`; returns the exit status and what the report says.

    Fruit whose inputs, settings and code are those of an earlier run keep their record. Raises BatchRefused
    where the batch as a whole cannot be graded, before anything is written.
    """
    started = now()
    batch = open_batch(root)
    results = Results(out or batch.folder.default_results)
    with alone(results):
        tasks = {row.fruit_id: fruit_task(batch, row.fruit_id, results) for row in batch.rows}
        records = dict(_kept(tasks))
        todo = [(fruit_id, task) for fruit_id, task in tasks.items() if fruit_id not in records]
        if records:
            console.print(
                f"{len(records)} of {len(tasks)} fruit unchanged since the last run", highlight=False
            )
        inputs = input_hashes(batch.folder.root, _inputs(batch))

        def provenance(status: int) -> None:
            write_provenance(
                results.provenance,
                settings=batch.settings.model_dump(mode="json"),
                inputs=inputs,
                started=started,
                finished=now(),
                exit_status=status,
                outcomes={fruit_id: record.outcome for fruit_id, record in records.items()},
            )

        try:
            _work(todo, records, jobs=jobs, time_limit_s=time_limit_s, console=console)
        except KeyboardInterrupt:
            provenance(INTERRUPTED)
            raise
        in_order = [records[row.fruit_id] for row in batch.rows]
        status = ALL_GRADED if all(r.graded for r in in_order) else SOME_NOT_GRADED
        entry = batch_entry(
            batch,
            in_order,
            results=results,
            inputs=inputs,
            started=started,
            finished=now(),
            exit_status=status,
        )
        write_whole(results.ranking, ranking_csv(entry))
        write_whole(results.report, report_html(entry))
        provenance(status)
    return status, entry


def _work(
    todo: list[tuple[str, FruitTask]],
    records: dict[str, FruitRecord],
    *,
    jobs: int,
    time_limit_s: float,
    console: Console,
) -> None:
    tasks = dict(todo)
    with (
        BatchProgress(console, total=len(todo)) as progress,
        closing(run_fruits(grade_fruit, todo, jobs=jobs, time_limit_s=time_limit_s)) as events,
    ):
        for event in events:
            if isinstance(event, Progressed):
                progress.stage(event.fruit_id, event.stage)
                continue
            record = _record_of(event, tasks[event.fruit_id], time_limit_s)
            records[event.fruit_id] = record
            progress.done(event.fruit_id, _in_a_line(record))


def _record_of(event: Event, task: FruitTask, time_limit_s: float) -> FruitRecord:
    """The record of a fruit that has ended; endings that its own process could not write are written here."""
    if isinstance(event, Finished) and isinstance(event.result, FruitRecord):
        return event.result
    if isinstance(event, TimedOut):
        outcome, particulars = Outcome.TIMED_OUT, f"{time_limit_s:g}"
    elif isinstance(event, Died):
        outcome, particulars = Outcome.CRASHED, _way_of_dying(event.exit_code)
    elif isinstance(event, Finished) and isinstance(event.result, BaseException):
        error = event.result
        outcome, particulars = Outcome.INTERNAL, f"{type(error).__name__}: {error}"
        write_whole(task.results.traceback, str(getattr(error, "traceback", particulars)))
    else:
        raise TypeError(event)
    return _ended(task, outcome, particulars)


def _ended(task: FruitTask, outcome: Outcome, particulars: str) -> FruitRecord:
    task.results.forget()
    record = FruitRecord(
        fruit_id=task.fruit_id,
        outcome=outcome.code,
        reason=outcome.sentence(particulars),
        key=task.key,
        given=task.given,
    )
    write_record(task.results.record, record)
    return record


def _way_of_dying(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        killed = " (often: out of memory)" if exit_code == -9 else ""
        return f"signal {-exit_code}{killed}"
    return f"exit status {exit_code}"


def _in_a_line(record: FruitRecord) -> str:
    if record.modulus is None:
        return f"{record.outcome}: {record.reason}"
    E_MPa, sd_MPa = record.modulus.E_MPa, record.modulus.E_sd_MPa
    return f"E = {E_MPa:.{decimals(sd_MPa)}f} ± {sd_MPa:.{decimals(sd_MPa)}f} MPa"


def _kept(tasks: Mapping[str, FruitTask]) -> Iterator[tuple[str, FruitRecord]]:
    """Records of an earlier run that still hold, with what staff wrote of the fruit brought up to date."""
    for fruit_id, task in tasks.items():
        record = read_record(task.results.record)
        if record is None or record.key != task.key or record.outcome in RETRIED:
            continue
        if record.graded and not task.results.fruit_ply.is_file():
            continue
        if record.given != task.given:
            record = record.model_copy(update={"given": task.given})
            write_record(task.results.record, record)
        yield fruit_id, record


def _inputs(batch: Batch) -> list[Path]:
    own = [batch.folder.settings, batch.folder.table, *own_files(batch.folder, batch.settings)]
    if batch.mat is not None:
        own.append(batch.folder.mat)
    return own + [path for row in batch.rows for path in batch.folder.fruit(row.fruit_id).input_files()]

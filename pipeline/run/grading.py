"""`drupe grade`: every fruit of a batch to its modulus, and the batch to a ranking and a report."""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from rich.console import Console

from pipeline.batch.control_chart import (
    ControlChart,
    chart_path,
    read_chart,
    require_chart_place,
    update_chart,
    with_points,
)
from pipeline.batch.layout import FruitResults, Results, write_whole
from pipeline.batch.opening import Batch, open_batch, own_files
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.provenance import input_hashes, write_provenance
from pipeline.batch.records import FruitRecord, write_record
from pipeline.batch.task import FruitTask, fruit_task
from pipeline.batch.write_guard import require_free, require_results_apart, require_temporary_apart
from pipeline.exit_status import DONE, DOUBTED, INTERRUPTED, UNUSABLE
from pipeline.files.results_lock import is_held, results_lock
from pipeline.files.whole_file import NotWritten, sweep
from pipeline.fruit.same_recording import copies_doubted, with_copies
from pipeline.fruit.stages import grade_fruit
from pipeline.problem import BatchRefused, Problem
from pipeline.ranking.batch_faults import BatchFault, batch_faults
from pipeline.ranking.reference_ratio import (
    ReferenceFinding,
    against_references,
    as_measured,
    drift,
    own_points,
)
from pipeline.ranking.report_entries import batch_entry
from pipeline.ranking.run_summary import cause, decimals
from pipeline.run.checking import implausible_batch, implausible_fruit
from pipeline.run.former_results import batch_folder, identity, require_same_batch
from pipeline.run.fruit_records import ended_record, kept_records, refused_record, with_forced
from pipeline.run.memory import LEAST_MIB, PER_FRUIT_MIB, free_memory_MiB, jobs_that_fit
from pipeline.run.progress import BatchProgress
from pipeline.run.runner import Died, Event, Finished, Progressed, TimedOut, run_fruits
from reports.entries import BatchEntry
from reports.page import report_html
from reports.tables import ranking_csv


def utc_now() -> datetime:
    """The time now, aware of its zone."""
    return datetime.now(UTC)


def grade(
    root: Path,
    out: Path | None,
    *,
    jobs: int,
    time_limit_s: float,
    console: Console,
    force: bool = False,
    screen: bool = True,
    now: Callable[[], datetime] = utc_now,
) -> tuple[int, BatchEntry]:
    """Grades the batch at `root` into `out`; returns the exit status and what the report says.

    Fruit whose inputs, settings and code are those of an earlier run keep their record. A fruit whose own
    numbers no fruit of the category has ends with that as its reason, and keeps what an earlier run made of
    it; with `force` it is graded, and that is one of its doubts. With `screen` every fruit is screened for
    missing physics; without, what an earlier run found stays. Raises BatchRefused where the batch as a
    whole cannot be graded, or `out` is no place for results or holds another batch's, before anything is
    written, and NotWritten where the batch's own files cannot be.
    """
    started, since_s = now(), time.monotonic()
    run = _placed(
        open_batch(root, force=force), out, started=started, since_s=since_s, force=force, screen=screen
    )
    if not is_held(run.results.root):
        run.require_ours()
    with results_lock(run.results.root):
        run.require_ours()
        _begun(run.results, run.fruits)
        records, todo, forced = _sorted_out(run, console)
        with suppress(NotWritten):
            run.write_provenance(records, None)
        try:
            jobs = _jobs([task for _, task in todo], jobs, console)
            _work(todo, records, jobs=jobs, time_limit_s=time_limit_s, console=console)
        except KeyboardInterrupt:
            with suppress(NotWritten):
                run.write_provenance(records, INTERRUPTED)
            raise
        for fruit_id, record in records.items():
            records[fruit_id] = with_forced(record, forced.get(fruit_id, ()), run.results)
        return _reported(run, records)


@dataclass(frozen=True, kw_only=True)
class _Run:
    """One run: its batch, where results and chart lie, the SHA-256 of what it reads, and when it began."""

    batch: Batch
    results: Results
    chart: Path | None
    inputs: Mapping[str, str]
    force: bool
    screen: bool
    started: datetime
    since_s: float

    @property
    def fruits(self) -> list[FruitResults]:
        return [self.results.fruit(row.fruit_id) for row in self.batch.rows]

    def until_now(self) -> datetime:
        return self.started + timedelta(seconds=time.monotonic() - self.since_s)

    def require_ours(self) -> None:
        """Raises BatchRefused where the results hold files of others, or another batch's."""
        require_free(self.results, self.fruits, "--out")
        require_same_batch(self.results, identity(self.batch, self.inputs), "--out")

    def write_provenance(
        self,
        records: Mapping[str, FruitRecord],
        status: int | None,
        finding: ReferenceFinding | None = None,
        faults: Sequence[BatchFault] = (),
    ) -> None:
        """batch.json, with the outcomes so far; `status` is None before the end. Raises NotWritten."""
        write_provenance(
            self.results.provenance,
            batch=batch_folder(self.batch),
            settings=self.batch.settings.model_dump(mode="json"),
            inputs=self.inputs,
            started=self.started,
            finished=None if status is None else self.until_now(),
            exit_status=status,
            outcomes={fruit_id: record.outcome for fruit_id, record in records.items()},
            reference=None if finding is None else asdict(finding),
            force=self.force,
            screened=self.screen,
            faults=[asdict(one) for one in faults],
        )


def _placed(
    batch: Batch, out: Path | None, *, started: datetime, since_s: float, force: bool, screen: bool
) -> _Run:
    """The run, whose places are fit to be written to; raises BatchRefused where one is not."""
    results = Results(out or batch.folder.default_results)
    require_results_apart(results, batch.folder, read_files(batch), "--out")
    require_temporary_apart(Path(tempfile.gettempdir()), batch.folder)
    named = batch.settings.reference.chart
    chart = None if named is None else chart_path(batch.folder, named)
    if chart is not None:
        require_chart_place(chart, batch.folder, results, read_files(batch))
    return _Run(
        batch=batch,
        results=results,
        chart=chart,
        inputs=input_hashes(batch.folder.root, _inputs(batch)),
        force=force,
        screen=screen,
        started=started,
        since_s=since_s,
    )


def _sorted_out(
    run: _Run, console: Console
) -> tuple[dict[str, FruitRecord], list[tuple[str, FruitTask]], dict[str, list[str]]]:
    """Records that are there already, kept or refused; what is to do; what fruit are graded in spite of."""
    tasks = {
        row.fruit_id: fruit_task(run.batch, row.fruit_id, run.results, screen=run.screen)
        for row in run.batch.rows
    }
    implausible = implausible_fruit(run.batch)
    forced: dict[str, list[str]] = {}
    if run.force:
        for fruit_id, sentence in implausible.items():
            console.print(f"{fruit_id}: {sentence} Graded all the same.", highlight=False, markup=False)
        forced, implausible = _forced(run.batch, implausible), {}
    records = dict(kept_records({name: task for name, task in tasks.items() if name not in implausible}))
    todo = [(name, task) for name, task in tasks.items() if name not in {*records, *implausible}]
    if records:
        console.print(f"{len(records)} of {len(tasks)} fruit unchanged since the last run", highlight=False)
    for fruit_id, sentence in implausible.items():
        records[fruit_id] = refused_record(tasks[fruit_id], sentence)
    return records, todo, forced


def _reported(run: _Run, records: Mapping[str, FruitRecord]) -> tuple[int, BatchEntry]:
    """Fruit held against each other and the reference bodies; ranking, report, provenance and chart written.

    The exit status and what the report says; raises NotWritten.
    """
    settings = run.batch.settings
    measured = [records[row.fruit_id] for row in run.batch.rows]
    compared = copies_doubted(measured, run.batch.folder)
    in_order, finding = against_references(compared, correct=settings.reference.correct)
    _keep_comparisons(measured, in_order, run.results)
    chart, own = ControlChart(), []
    if run.chart is not None and finding is not None:
        own = own_points(finding, lot=settings.lot, now=run.started, inputs=run.inputs)
        chart = with_points(read_chart(run.chart), own)
        finding = drift(chart, finding)
    faults = batch_faults(in_order)
    status = _status(in_order, finding)
    entry = batch_entry(
        run.batch,
        in_order,
        results=run.results,
        inputs=run.inputs,
        started=run.started,
        finished=run.until_now(),
        exit_status=status,
        finding=finding,
        chart=chart,
        faults=faults,
    )
    write_whole(run.results.ranking, ranking_csv(entry))
    write_whole(run.results.report, report_html(entry))
    run.write_provenance(records, status, finding, faults)
    if run.chart is not None and own:
        update_chart(run.chart, own)
    return status, entry


def _status(records: Sequence[FruitRecord], finding: ReferenceFinding | None) -> int:
    """The exit status of a run that went to its end; what staff must look into is no 0."""
    if not all(one.graded for one in records):
        return UNUSABLE
    alarm = finding is not None and finding.alarm
    return DOUBTED if alarm or any(one.doubts for one in records) else DONE


def _keep_comparisons(
    measured: Sequence[FruitRecord], compared: Sequence[FruitRecord], results: Results
) -> None:
    """Every record.json says what the reference bodies make of its fruit, and which of its recordings other
    fruit have too, beside what was measured.
    """
    for record, one in zip(measured, compared, strict=True):
        kept = with_copies(as_measured(record, one), one.copied)
        if kept != record:
            write_record(results.fruit(record.fruit_id).record, kept)


def _begun(results: Results, fruits: Sequence[FruitResults]) -> None:
    """The list of what is written is begun, and what killed runs left unfinished is gone."""
    results.claim()
    sweep(results.root)
    for fruit in fruits:
        fruit.sweep()


def _jobs(todo: Sequence[FruitTask], jobs: int, console: Console) -> int:
    """As many fruit at once as asked for, or as memory holds; raises BatchRefused where it holds none."""
    free_MiB = free_memory_MiB()
    if not todo or free_MiB is None:
        return jobs
    need_MiB = max(PER_FRUIT_MIB[_kind(task)] for task in todo)
    if free_MiB < LEAST_MIB:
        sentence = (
            f"has {free_MiB:.0f} MiB of memory left, and one fruit needs about {need_MiB:.0f} MiB; "
            "close other programs, or raise the limit of the container."
        )
        raise BatchRefused([Problem("this machine", sentence)])
    wanted = min(jobs, len(todo))
    fit = jobs_that_fit(wanted, per_fruit_MiB=need_MiB, free_MiB=free_MiB)
    if fit < wanted:
        console.print(
            f"{fit} fruit at a time instead of {wanted}: {free_MiB:.0f} MiB of memory are left, and one "
            f"fruit needs about {need_MiB:.0f} MiB",
            highlight=False,
        )
    return fit


def _kind(task: FruitTask) -> str:
    """What a fruit's memory goes by."""
    if task.folder.fruit_ply.is_file():
        return "mesh"
    return "traces" if task.folder.without_shape() else "photos"


def _work(
    todo: list[tuple[str, FruitTask]],
    records: dict[str, FruitRecord],
    *,
    jobs: int,
    time_limit_s: float,
    console: Console,
) -> None:
    """Grades what is to do, shows how far it is, and puts each record into `records` as it comes."""
    tasks = dict(todo)
    with (
        BatchProgress(console, total=len(todo), jobs=jobs) as progress,
        closing(run_fruits(grade_fruit, todo, jobs=jobs, time_limit_s=time_limit_s)) as events,
    ):
        for event in events:
            if isinstance(event, Progressed):
                progress.stage(event.fruit_id, event.stage)
                continue
            record = _record_of(event, tasks[event.fruit_id], time_limit_s)
            records[event.fruit_id] = record
            progress.done(event.fruit_id, _in_a_line(record), whole=record.graded)


def _record_of(event: Event, task: FruitTask, time_limit_s: float) -> FruitRecord:
    """The record of a fruit that has ended; endings that its own process could not write are written here."""
    if isinstance(event, Finished) and isinstance(event.result, FruitRecord):
        return event.result
    if isinstance(event, TimedOut):
        outcome, particulars = Outcome.TIMED_OUT, f"{time_limit_s:g}"
    elif isinstance(event, Died):
        outcome, particulars = Outcome.CRASHED, _way_of_dying(event.exit_code)
    elif isinstance(event, Finished) and isinstance(event.result, BaseException):
        outcome, particulars = ending_of(event.result)
    else:
        raise TypeError(event)
    record = ended_record(task, outcome, particulars)
    if outcome is Outcome.INTERNAL and isinstance(event, Finished):
        with suppress(NotWritten):
            write_whole(task.results.traceback, str(getattr(event.result, "traceback", particulars)))
    return record


def _forced(batch: Batch, of_fruit: Mapping[str, str]) -> dict[str, list[str]]:
    """What each fruit is graded in spite of, as sentences for its doubts."""
    said = implausible_batch(batch)
    for fruit_id, sentence in of_fruit.items():
        said.setdefault(fruit_id, []).append(sentence)
    return {name: [f"{one} Graded all the same (--force)." for one in all_] for name, all_ in said.items()}


def _way_of_dying(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        killed = " (often: out of memory)" if exit_code == -9 else ""
        return f"signal {-exit_code}{killed}"
    return f"exit status {exit_code}"


def _in_a_line(record: FruitRecord) -> str:
    """What the progress line says of a fruit: its E and why that is in doubt, or why it has none."""
    if not record.graded or record.modulus is None:
        return f"{record.outcome}: {record.reason}"
    E_MPa, sd_MPa = record.modulus.E_MPa, record.modulus.E_sd_MPa
    doubt = f", in doubt: {cause(record.doubts)}" if record.doubts else ""
    return f"E = {E_MPa:.{decimals(sd_MPa)}f} ± {sd_MPa:.{decimals(sd_MPa)}f} MPa{doubt}"


def read_files(batch: Batch) -> list[Path]:
    """Every file that grading the batch reads."""
    model = batch.settings.recon.geometry_model
    return _inputs(batch) + ([] if model is None else [batch.folder.root / model])


def _inputs(batch: Batch) -> list[Path]:
    own = [batch.folder.settings, batch.folder.table, *own_files(batch.folder, batch.settings)]
    if batch.mat is not None:
        own.append(batch.folder.mat)
    return own + [path for row in batch.rows for path in batch.folder.fruit(row.fruit_id).input_files()]

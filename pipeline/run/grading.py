"""`drupe grade`: every fruit of a batch to its modulus, and the batch to a ranking and a report."""

import time
from collections.abc import Callable, Collection, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path

from rich.console import Console

from pipeline.address_space import MAPPED_MIB, lacking
from pipeline.batch.batch_fruits import write_run
from pipeline.batch.layout import FruitFolder, FruitResults, Results, write_whole
from pipeline.batch.opening import Batch, named_files, open_batch, own_files
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.provenance import input_hashes
from pipeline.batch.records import FruitRecord
from pipeline.batch.results_lock import is_held, results_lock
from pipeline.batch.task import FruitTask
from pipeline.batch.unused_files import unused_of_batch
from pipeline.batch.write_guard import require_free, require_results_place
from pipeline.exit_status import INTERRUPTED, USAGE
from pipeline.files.whole_file import NotWritten, sweep
from pipeline.problem import BatchRefused, Problem, refused
from pipeline.ranking.run_summary import decimals
from pipeline.run.batch_run import BatchRun, GradeOptions
from pipeline.run.console import utc_now
from pipeline.run.engines import WorkPlace, cluster_of
from pipeline.run.former_results import identity, require_same_batch
from pipeline.run.fruit_queue import FruitQueue, WaitingFruit
from pipeline.run.fruit_records import ended_record, with_forced
from pipeline.run.fruit_work import work_on
from pipeline.run.memory import LEAST_MIB, PER_FRUIT_MIB, free_memory_MiB, jobs_that_fit, share_MiB
from pipeline.run.packed_records import PackedRecords
from pipeline.run.progress import BatchProgress
from pipeline.run.reporting import ReportSoFar, report, report_of_records
from pipeline.run.runner import LocalPool
from pipeline.run.scheduling import Died, Engine, Event, Finished, Noted, Progressed, TimedOut, run_on
from recon.learned.onnx_file import model_files
from reports.entries import BatchEntry

MOST_UNUSED_SAID = 20
"""Lines on files that are not used: more of them hide the rest of what is printed."""


class InterruptedAtWork(KeyboardInterrupt):
    """Ctrl-C came while fruit were worked on; ranking and report of those done are written."""


def grade(
    root: Path,
    out: Path | None,
    options: GradeOptions,
    *,
    console: Console,
    opened: Batch | None = None,
    retried: Collection[str] | None = None,
    say_unchanged: bool = True,
    place: WorkPlace | None = None,
    records: PackedRecords | None = None,
    waiting: int | None = None,
    now: Callable[[], datetime] = utc_now,
) -> tuple[int, BatchEntry]:
    """Grades the batch at `root` into `out`; returns the exit status and what the report says.

    `opened`: the batch as it was read, with those rows that are to be graded; None: it is read here, whole.
    `retried`: fruit that are tried again where an earlier run ended them for a cause that may pass; None:
    all. `say_unchanged`: whether it is said how many are as that run left them. `place`: where fruit are
    worked on; None: on this machine. `records`: empty; where the fruit's records are put, those too that
    there are when it raises. `waiting`: fruit of a watched batch that wait until these are done; None: the
    batch is not watched.

    Fruit whose inputs, settings and code are those of an earlier run keep their record. A fruit whose own
    numbers no fruit of the category has ends with that as its reason, and keeps what an earlier run made of
    it; with `force` it is graded, and that is one of its doubts. Without `screen`, what an earlier run's
    screen found stays. Raises BatchRefused where the batch as a
    whole cannot be graded, or `out` is no place for results or holds another batch's, before anything is
    written, NotWritten where the batch's own files cannot be, and InterruptedAtWork.
    """
    began = now(), time.monotonic()
    place = place or WorkPlace()
    place.require_parts()
    run = _placed(opened or open_batch(root, force=options.force), out, options, began=began)
    if not is_held(run.results.root):
        run.require_ours()
    with results_lock(run.results.root):
        run.require_ours()
        _begun(run.results, run.fruits)
        write_run(run.results, run.batch.row_of, mark=place.mark)
        queue = FruitQueue(run, console, retried, records=records)
        records = queue.records
        if say_unchanged and queue.kept:
            kept = f"{queue.kept} of {len(run.batch.rows)} fruit unchanged since the last run"
            console.print(kept, highlight=False)
        if say_unchanged:
            _say_unused(run.batch, console)
        with suppress(NotWritten):
            run.write_provenance(records.outcomes, None)
        so_far = ReportSoFar(run, records)
        try:
            if queue.todo:
                engine = _engine(run, queue, place, options, console)
                _work(queue, engine, options, lambda _: so_far.write_when_due(), console, waiting)
        except KeyboardInterrupt:
            _broken_off(run, records, so_far, INTERRUPTED)
            raise InterruptedAtWork from None
        except BatchRefused:
            _broken_off(run, records, so_far, USAGE)
            raise
        for fruit_id in records:
            records[fruit_id] = with_forced(records[fruit_id], queue.forced(fruit_id), run.results)
        return report(run, records)


def grade_newcomers(
    batch: Batch,
    out: Path,
    newcomers: Collection[str],
    records: PackedRecords,
    options: GradeOptions,
    *,
    console: Console,
    ended: Callable[[BatchRun, FruitRecord], None],
    waiting: int = 0,
    now: Callable[[], datetime] = utc_now,
) -> None:
    """Grades fruit of a batch that `grade` has graded into `out` without them, or as they were before.

    `batch`: as it was read, with the fruit so far and the newcomers; `records`: those of the other fruit, to
    which the newcomers' are added, each told to `ended` as it comes; `waiting` as in `grade`. Of other fruit
    no file is read, and neither ranking nor report is made: `report_graded` and the next `grade` do that.
    Raises BatchRefused and NotWritten as `grade` does.
    """
    run = _placed(batch, out, options, newcomers=newcomers, began=(now(), time.monotonic()))
    fruits = [run.results.fruit(fruit_id) for fruit_id in newcomers]
    with results_lock(run.results.root):
        own_files = (*run.results.files, run.results.run)
        require_free((*own_files, *(path for fruit in fruits for path in fruit.files)), "--out")
        require_same_batch(run.results, identity(batch, run.inputs), "--out")
        _begun(run.results, fruits)
        write_run(run.results, batch.row_of, mark=WorkPlace().mark)
        queue = FruitQueue(run, console, newcomers, fruits=newcomers, records=records)
        for fruit_id in [newcomer for newcomer in newcomers if newcomer in records]:
            records[fruit_id] = with_forced(records[fruit_id], queue.forced(fruit_id), run.results)
            ended(run, records[fruit_id])
        if queue.todo:
            engine = _processes(queue.todo, options, console)
            _work(queue, engine, options, partial(ended, run), console, waiting)


def report_graded(
    batch: Batch,
    out: Path,
    records: PackedRecords,
    options: GradeOptions,
    *,
    now: Callable[[], datetime] = utc_now,
) -> tuple[int, BatchEntry | None]:
    """Ranking and report of fruit that `grade` and `grade_newcomers` have graded; none is worked on.

    What `grade` returns. Where fruit of the batch are not in `records`, all that is written is that of an
    interrupted run, and so is the status; no entry where no fruit is. Raises BatchRefused and NotWritten as
    `grade` does.
    """
    run = _placed(batch, out, options, began=(now(), time.monotonic()))
    with results_lock(run.results.root):
        run.require_ours()
        status, entry = report_of_records(run, records)
        if status == INTERRUPTED:
            _write_broken_off(run, records, status)
        return status, entry


def _broken_off(run: BatchRun, records: PackedRecords, so_far: ReportSoFar, status: int) -> None:
    """What a run leaves that ends before its fruit are done; what cannot be written is left out."""
    _write_broken_off(run, records, status)
    so_far.write(interrupted=True)


def _write_broken_off(run: BatchRun, records: PackedRecords, status: int) -> None:
    with suppress(NotWritten):
        run.write_provenance(records.outcomes, status)


def _placed(
    batch: Batch,
    out: Path | None,
    options: GradeOptions,
    *,
    began: tuple[datetime, float],
    newcomers: Collection[str] | None = None,
) -> BatchRun:
    """The run, whose places are fit to be written to; raises BatchRefused where one is not.

    `began`: by the calendar, and in seconds of the monotonic clock. `newcomers`: fruit of the batch that
    alone are read; such a run has no hashes, as it makes no report.
    """
    options.report.require_parts()
    results = Results(out or batch.folder.default_results)
    rows = batch.rows if newcomers is None else tuple(batch.row_of[fruit_id] for fruit_id in newcomers)
    inputs = _inputs(replace(batch, rows=rows))
    require_results_place(results.root, batch.folder, "--out")
    return BatchRun(
        batch=batch,
        results=results,
        inputs=input_hashes(batch.folder.root, inputs) if newcomers is None else {},
        force=options.force,
        screen=options.screen,
        options=options.report,
        started=began[0],
        since_s=began[1],
    )


def _say_unused(batch: Batch, console: Console) -> None:
    """Prints which files outside the fruit's folders look like inputs and are not used; a fruit's own files
    are among its warnings.
    """
    unused = unused_of_batch(batch.folder, named_files(batch.folder, batch.settings))
    lines = [
        str(Problem(str(unused_file.path.relative_to(batch.folder.root)), unused_file.sentence))
        for unused_file in unused
    ]
    more = len(lines) - MOST_UNUSED_SAID
    lines[MOST_UNUSED_SAID:] = [f"and {more} more: `drupe check` lists all"] if more > 0 else []
    for line in lines:
        console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)


def _begun(results: Results, fruits: Sequence[FruitResults]) -> None:
    """The list of what is written is begun, and what killed runs left unfinished is gone."""
    results.claim()
    sweep(results.root)
    for fruit in fruits:
        fruit.sweep()


def _engine(
    run: BatchRun, queue: FruitQueue, place: WorkPlace, options: GradeOptions, console: Console
) -> Engine:
    """What the fruit are worked on by; raises BatchRefused where this machine's memory holds none."""
    if place.here:
        return _processes(queue.todo, options, console)
    return cluster_of(
        place,
        run,
        fruits=len(queue.todo),
        per_fruit_MiB=_per_fruit_MiB(queue.todo),
        time_limit_s=options.time_limit_s,
        tell=lambda line: console.print(line, highlight=False, markup=False, soft_wrap=True),
    )


def _processes(todo: Sequence[WaitingFruit], options: GradeOptions, console: Console) -> Engine:
    """Processes of this machine, each with its share of the memory that is free now as its limit; raises
    BatchRefused where memory, or the limit of address space, holds no fruit.
    """
    need_MiB = _per_fruit_MiB(todo)
    if said := lacking(need_MiB + MAPPED_MIB, threads=1):
        raise refused("this machine", said)
    fit = _jobs(todo, options.jobs, console)
    free_MiB = free_memory_MiB()
    most_MiB = None if free_MiB is None else share_MiB(min(fit, len(todo)), need_MiB, free_MiB=free_MiB)
    return LocalPool(jobs=fit, time_limit_s=options.time_limit_s, most_MiB=most_MiB)


def _jobs(todo: Sequence[WaitingFruit], jobs: int, console: Console) -> int:
    """As many fruit at once as asked for, or as memory holds; raises BatchRefused where it holds none."""
    free_MiB = free_memory_MiB()
    if free_MiB is None:
        return jobs
    need_MiB = _per_fruit_MiB(todo)
    if free_MiB < LEAST_MIB:
        sentence = (
            f"has {free_MiB:.0f} MiB of free memory, but one fruit needs about {need_MiB:.0f} MiB; "
            "close other programs, or raise the container's limit."
        )
        raise refused("this machine", sentence)
    wanted = min(jobs, len(todo))
    fit = jobs_that_fit(wanted, per_fruit_MiB=need_MiB, free_MiB=free_MiB)
    if fit < wanted:
        console.print(
            f"{fit} fruit at a time instead of {wanted}: {free_MiB:.0f} MiB of memory are free, and "
            f"one fruit needs about {need_MiB:.0f} MiB",
            highlight=False,
        )
    return fit


def _per_fruit_MiB(todo: Sequence[WaitingFruit]) -> float:
    return max(PER_FRUIT_MIB[kind] for kind in {_kind(waiting.folder) for waiting in todo})


def _kind(fruit: FruitFolder) -> str:
    if fruit.fruit_ply.is_file():
        return "mesh"
    return "traces" if fruit.without_shape() else "photos"


def _work(
    queue: FruitQueue,
    engine: Engine,
    options: GradeOptions,
    ended: Callable[[FruitRecord], None],
    console: Console,
    waiting: int | None,
) -> None:
    """Grades what is to do, shows how far it is, puts each record into the queue's records as it comes, and
    tells it to `ended`.
    """
    before = None if waiting is None else len(queue.records)
    total = len(queue.todo) + (waiting or 0)
    with (
        BatchProgress(console, total=total, jobs=engine.at_once, before=before) as progress,
        closing(run_on(engine, work_on, queue)) as events,
    ):

        def show_ended(record: FruitRecord) -> None:
            progress.done(record.fruit_id, _in_a_line(record), whole=record.graded)
            ended(record)

        for event in events:
            while queue.refused:
                show_ended(queue.refused.popleft())
            progress.jobs = engine.at_once
            if isinstance(event, Noted):
                progress.noted(event.fruit_id, event.line)
                continue
            if isinstance(event, Progressed):
                progress.stage(event.fruit_id, event.stage)
                continue
            record = _record_of(event, queue.ended(event.fruit_id), options.time_limit_s)
            queue.records[event.fruit_id] = record
            show_ended(record)
        while queue.refused:
            show_ended(queue.refused.popleft())


def _record_of(event: Event, task: FruitTask, time_limit_s: float) -> FruitRecord:
    """The record of a fruit that has ended; endings that its own process could not write are written here."""
    if isinstance(event, Finished) and isinstance(event.result, FruitRecord):
        return event.result
    if isinstance(event, TimedOut):
        outcome, particulars = Outcome.TIMED_OUT, f"{time_limit_s:g}"
    elif isinstance(event, Died):
        outcome, particulars = Outcome.CRASHED, event.how or _way_of_dying(event.exit_code)
    elif isinstance(event, Finished) and isinstance(event.result, BaseException):
        outcome, particulars = ending_of(event.result)
    else:
        raise TypeError(event)
    record = ended_record(task, outcome, particulars)
    if outcome is Outcome.INTERNAL and isinstance(event, Finished):
        with suppress(NotWritten):
            write_whole(task.results.traceback, str(getattr(event.result, "traceback", particulars)))
    return record


def _way_of_dying(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        killed = " (often: out of memory)" if exit_code == -9 else ""
        return f"signal {-exit_code}{killed}"
    return f"exit status {exit_code}"


def _in_a_line(record: FruitRecord) -> str:
    """What the progress line says of a fruit: its E and whether that is in doubt, or why it has none."""
    if not record.graded or record.modulus is None:
        return f"{record.outcome}: {record.reason}"
    E_MPa, sd_MPa = record.modulus.E_MPa, record.modulus.E_sd_MPa
    doubt = ", in doubt (see the causes below)" if record.doubts else ""
    return f"E = {E_MPa:.{decimals(sd_MPa)}f} ± {sd_MPa:.{decimals(sd_MPa)}f} MPa{doubt}"


def read_files(batch: Batch) -> list[Path]:
    """Every file that grading the batch reads."""
    return [*_inputs(batch), *_models(batch)]


def _models(batch: Batch) -> list[Path]:
    model = batch.settings.recon.geometry_model
    return [] if model is None else [*model_files(batch.folder.root / model)]


def _inputs(batch: Batch) -> list[Path]:
    paths = [batch.folder.settings, batch.folder.table, *own_files(batch.folder, batch.settings)]
    if batch.mat is not None:
        paths.append(batch.folder.mat)
    return paths + [path for row in batch.rows for path in batch.folder.fruit(row.fruit_id).input_files()]

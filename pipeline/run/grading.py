"""`drupe grade`: the modulus of every fruit of a batch, then ranking and report."""

import time
from collections.abc import Callable, Collection
from contextlib import closing, suppress
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path

from rich.console import Console

from pipeline.batch.layout import FruitFolder, Results, write_whole
from pipeline.batch.named_priors import named_files, own_files
from pipeline.batch.opening import Batch, open_batch
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.provenance import input_hashes, write_run
from pipeline.batch.records import FruitRecord, write_changed
from pipeline.batch.task import FruitTask
from pipeline.batch.unused_files import unused_of_batch
from pipeline.batch.write_guard import is_held, require_results_place, results_lock
from pipeline.exit_status import INTERRUPTED, USAGE
from pipeline.files.limited_memory import free_memory_MiB
from pipeline.files.whole_file import NotWritten, sweep
from pipeline.problem import BatchRefused, refused
from pipeline.ranking.run_summary import decimals
from pipeline.run.batch_run import BatchRun, GradeOptions, utc_now
from pipeline.run.fruit_queue import FruitQueue, ended_record
from pipeline.run.memory import LEAST_MIB, PER_FRUIT_MIB, jobs_that_fit, share_MiB
from pipeline.run.progress import BatchProgress, say
from pipeline.run.reporting import ReportPace, outcomes_of, report, report_so_far
from pipeline.run.runner import LocalPool, work_on
from pipeline.run.scheduling import Died, Engine, Event, Finished, Noted, Progressed, TimedOut, run_on
from pipeline.safe_start import elsewhere
from recon.learned.onnx_file import model_files
from reports.entries import BatchEntry

MOST_UNUSED_SAID = 20
"""Most lines on unused files: more would hide the other output."""


def grade(
    root: Path,
    out: Path | None,
    options: GradeOptions,
    *,
    console: Console,
) -> tuple[int, BatchEntry]:
    """Grades the batch at `root` into `out`; returns the exit status and the content of the report.

    Fruit with the same inputs, settings and code as in an earlier run keep their record. A fruit whose own
    numbers are implausible for its category is graded only with `force`, and with a doubt. Without `screen`,
    results of an earlier run's screen stay. Raises BatchRefused before it writes anything, if the batch as a
    whole cannot be graded, or if `out` is unsuitable or belongs to another batch. Raises NotWritten if it
    cannot write the batch's files. It writes ranking and report of the finished fruit after Ctrl-C, or if
    lack of memory or the cluster stops the run (BatchRefused).
    """
    began = utc_now(), time.monotonic()
    options.place.require_parts()
    run = placed(open_batch(root, force=options.force), out, options, began=began)
    if not is_held(run.results.root):
        run.require_ours()
    with results_lock(run.results.root):
        run.require_ours()
        records: dict[str, FruitRecord] = {}
        fruit = run.batch.row_of
        pace = ReportPace()

        def report_when_due(_: FruitRecord) -> None:
            """At the end, `report` writes the report of all fruit."""
            if len(records) < len(fruit) and pace.due():
                with pace.reporting():
                    report_so_far(run, records)

        queue = begun(run, fruit, records, console=console)
        say_begun(queue)
        with suppress(NotWritten):
            run.write_provenance(outcomes_of(records), None)
        try:
            grade_queue(queue, report_when_due)
        except (KeyboardInterrupt, BatchRefused) as stopped:
            with suppress(NotWritten):
                status = INTERRUPTED if isinstance(stopped, KeyboardInterrupt) else USAGE
                run.write_provenance(outcomes_of(records), status)
            report_so_far(run, records, interrupted=True)
            raise
        return report(run, records)


def begun(
    run: BatchRun, chosen: Collection[str], records: dict[str, FruitRecord], *, console: Console
) -> FruitQueue:
    """Prepares the results for the `chosen` fruit of a run; returns the queue of the fruit to grade.
    `records` gets those that an earlier run graded unchanged. The caller holds the lock of the results.
    """
    run.results.claim()
    sweep(run.results.root)
    for fruit_id in chosen:
        run.results.fruit(fruit_id).sweep()
    write_run(run.results, mark=run.options.place.mark)
    return FruitQueue(run, chosen, records, console)


def grade_queue(
    queue: FruitQueue, ended: Callable[[FruitRecord], None], *, waiting: int | None = None
) -> None:
    """Grades the queue's fruit, and calls `ended` with each record. `waiting`: fruit of a watched batch that
    wait until these are done; None: the batch is not watched.
    """
    if queue.todo:
        _work(queue, _engine(queue), ended, waiting)
    for fruit_id in (*queue.kept, *queue.todo):
        before = queue.records[fruit_id]
        now = before.with_doubts("forced", queue.forced(fruit_id) if before.graded else ())
        path = queue.run.results.fruit(fruit_id).record
        queue.records[fruit_id] = write_changed(path, before, now)


def placed(
    batch: Batch,
    out: Path | None,
    options: GradeOptions,
    *,
    began: tuple[datetime, float],
    hashed: bool = True,
) -> BatchRun:
    """The run, with places that are fit for writing; raises BatchRefused if one is not.

    `began`: UTC time, and seconds of the monotonic clock. `hashed`: whether to hash the inputs, which a
    report needs.
    """
    results = Results(out or batch.folder.default_results)
    require_results_place(results.root, batch.folder)
    return BatchRun(
        batch=batch,
        results=results,
        inputs=input_hashes(batch.folder.root, _inputs(batch)) if hashed else {},
        options=options,
        started=began[0],
        since_s=began[1],
    )


def say_begun(queue: FruitQueue) -> None:
    """Prints how many fruit an earlier run has left unchanged, and which files outside the fruit's folders
    look like inputs but are unused. Warnings of a fruit name its own unused files.
    """
    batch = queue.run.batch
    if queue.kept:
        say(queue.console, f"{len(queue.kept)} of {len(batch.rows)} fruit unchanged since the last run")
    unused = unused_of_batch(batch.folder, named_files(batch.folder, batch.settings))
    root = batch.folder.root
    lines = [str(replace(problem, file=str(Path(problem.file).relative_to(root)))) for problem in unused]
    more = len(lines) - MOST_UNUSED_SAID
    lines[MOST_UNUSED_SAID:] = [f"and {more} more: `drupe check` lists all"] if more > 0 else []
    for line in lines:
        say(queue.console, f"warning: {line}")


def _engine(queue: FruitQueue) -> Engine:
    """The engine that grades the fruit; raises BatchRefused if this machine has too little memory for one."""
    run, todo = queue.run, queue.todo.values()
    place = run.options.place
    if place.here:
        return _processes(todo, run.options, queue.console)
    with elsewhere():
        from pipeline.run.cluster import Cluster
        from pipeline.run.cluster_worker import RunNeeds, this_drupe

    needs = RunNeeds(
        drupe=this_drupe(),
        settings=run.batch.folder.settings.absolute(),
        run=run.results.run.absolute(),
        mark=place.mark,
        per_fruit_MiB=_per_fruit_MiB(todo),
    )
    return Cluster(
        place.scheduler,
        workers=min(place.jobs or 1, len(todo)) if place.slurm else 0,
        needs=needs,
        time_limit_s=run.options.time_limit_s,
        tell=partial(say, queue.console),
        most=None if place.slurm else place.jobs,
    )


def _processes(todo: Collection[FruitFolder], options: GradeOptions, console: Console) -> LocalPool:
    """Processes of this machine, each limited to its share of the free memory; raises BatchRefused if memory
    is too small for one fruit.
    """
    free_MiB, need_MiB = free_memory_MiB(), _per_fruit_MiB(todo)
    if free_MiB is None:
        return LocalPool(jobs=options.jobs, time_limit_s=options.time_limit_s)
    if free_MiB < LEAST_MIB:
        sentence = (
            f"has {free_MiB:.0f} MiB of free memory, but one fruit needs about {need_MiB:.0f} MiB; "
            "close other programs, or raise the container's limit."
        )
        raise refused("this machine", sentence)
    wanted = min(options.jobs, len(todo))
    fit = jobs_that_fit(wanted, per_fruit_MiB=need_MiB, free_MiB=free_MiB)
    if fit < wanted:
        say(
            console,
            f"{fit} fruit at a time instead of {wanted}: {free_MiB:.0f} MiB of memory are free, and "
            f"one fruit needs about {need_MiB:.0f} MiB",
        )
    most_MiB = share_MiB(fit, need_MiB, free_MiB=free_MiB)
    return LocalPool(jobs=fit, time_limit_s=options.time_limit_s, most_MiB=most_MiB)


def _per_fruit_MiB(todo: Collection[FruitFolder]) -> float:
    return max(PER_FRUIT_MIB[kind] for kind in set(map(_kind, todo)))


def _kind(fruit: FruitFolder) -> str:
    if fruit.fruit_ply.is_file():
        return "mesh"
    return "traces" if fruit.without_shape() else "photos"


def _work(
    queue: FruitQueue, engine: Engine, ended: Callable[[FruitRecord], None], waiting: int | None
) -> None:
    """Grades the queue's fruit and shows progress; puts each record into the queue's records, and calls
    `ended` with it.
    """
    before = None if waiting is None else len(queue.records)
    total = len(queue.todo) + (waiting or 0)
    with (
        BatchProgress(queue.console, total=total, before=before) as progress,
        closing(run_on(engine, work_on, queue)) as events,
    ):
        for event in events:
            if isinstance(event, Noted):
                progress.noted(event.fruit_id, event.line)
            elif isinstance(event, Progressed):
                progress.stage(event.fruit_id, event.stage)
            else:
                record = _record_of(event, queue.ended(event.fruit_id), queue.run.options.time_limit_s)
                queue.records[event.fruit_id] = record
                progress.done(record.fruit_id, _in_a_line(record))
                ended(record)


def _record_of(event: Event, task: FruitTask, time_limit_s: float) -> FruitRecord:
    """The record of a fruit that has ended; writes it if the fruit's own process could not."""
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
    """The progress line on a fruit: its E and whether that is in doubt, or why it has none."""
    if not record.graded or record.modulus is None:
        return f"{record.outcome}: {record.reason}"
    E_MPa, sd_MPa = record.modulus.E_MPa, record.modulus.E_sd_MPa
    doubt = ", in doubt (see the causes below)" if record.doubts else ""
    return f"E = {E_MPa:.{decimals(sd_MPa)}f} ± {sd_MPa:.{decimals(sd_MPa)}f} MPa{doubt}"


def read_files(batch: Batch) -> list[Path]:
    """Every file that grading the batch reads."""
    model = batch.settings.recon.geometry_model
    return [*_inputs(batch), *(() if model is None else model_files(batch.folder.root / model))]


def _inputs(batch: Batch) -> list[Path]:
    paths = [batch.folder.settings, batch.folder.table, *own_files(batch.folder, batch.settings)]
    if batch.mat is not None:
        paths.append(batch.folder.mat)
    return paths + [path for row in batch.rows for path in batch.folder.fruit(row.fruit_id).input_files()]

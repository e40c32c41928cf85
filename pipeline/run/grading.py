"""`drupe grade`: every fruit of a batch to its modulus, and the batch to a ranking and a report."""

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
from pipeline.batch.records import FruitRecord
from pipeline.batch.results_lock import is_held, results_lock
from pipeline.batch.task import FruitTask
from pipeline.batch.unused_files import unused_of_batch
from pipeline.batch.write_guard import require_results_place
from pipeline.exit_status import INTERRUPTED, USAGE
from pipeline.files.whole_file import NotWritten, sweep
from pipeline.problem import BatchRefused, refused
from pipeline.ranking.run_summary import decimals
from pipeline.run.batch_run import BatchRun, GradeOptions, utc_now
from pipeline.run.fruit_queue import FruitQueue, ended_record, with_forced
from pipeline.run.memory import LEAST_MIB, PER_FRUIT_MIB, free_memory_MiB, jobs_that_fit, share_MiB
from pipeline.run.progress import BatchProgress, say
from pipeline.run.reporting import ReportPace, outcomes_of, report, report_so_far
from pipeline.run.runner import LocalPool, work_on
from pipeline.run.scheduling import Died, Engine, Event, Finished, Noted, Progressed, TimedOut, run_on
from pipeline.safe_start import elsewhere
from recon.learned.onnx_file import model_files
from reports.entries import BatchEntry

MOST_UNUSED_SAID = 20
"""Lines on files that are not used: more of them hide the rest of what is printed."""


def grade(
    root: Path,
    out: Path | None,
    options: GradeOptions,
    *,
    console: Console,
) -> tuple[int, BatchEntry]:
    """Grades the batch at `root` into `out`; returns the exit status and what the report says.

    Fruit whose inputs, settings and code are those of an earlier run keep their record. A fruit whose own
    numbers no fruit of the category has ends with that as its reason; with `force` it is graded, and that is
    one of its doubts. Without `screen`, what an earlier run's screen found stays. Raises BatchRefused where
    the batch as a whole cannot be graded, or `out` is no place for results or holds another batch's, before
    anything is written, and NotWritten where the batch's own files cannot be. After Ctrl-C ranking and report
    of those done are written.
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
            """The end writes the report of all fruit."""
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
    """Makes the results ready for the `chosen` fruit of a run, of which those that an earlier run graded as
    they are get their record; the queue of the others. The caller holds the lock of the results.
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
    """Grades what is to do, and tells each record to `ended` as it comes. `waiting`: fruit of a watched batch
    that wait until these are done; None: the batch is not watched.
    """
    if queue.todo:
        _work(queue, _engine(queue), ended, waiting)
    for fruit_id in (*queue.kept, *queue.todo):
        queue.records[fruit_id] = with_forced(
            queue.records[fruit_id], queue.forced(fruit_id), queue.run.results
        )


def placed(
    batch: Batch,
    out: Path | None,
    options: GradeOptions,
    *,
    began: tuple[datetime, float],
    hashed: bool = True,
) -> BatchRun:
    """The run, whose places are fit to be written to; raises BatchRefused where one is not.

    `began`: by the calendar, and in seconds of the monotonic clock. `hashed`: whether its inputs are, which a
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
    """Prints how many fruit are as an earlier run left them, and which files outside the fruit's folders look
    like inputs and are not used; a fruit's own files are among its warnings.
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
    """What the fruit are worked on by; raises BatchRefused where this machine's memory holds none."""
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
    """Processes of this machine, each with its share of the memory that is free now as its limit; raises
    BatchRefused where memory holds no fruit.
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
    """Grades what is to do, shows how far it is, puts each record into the queue's records as it comes, and
    tells it to `ended`.
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
    model = batch.settings.recon.geometry_model
    return [*_inputs(batch), *(() if model is None else model_files(batch.folder.root / model))]


def _inputs(batch: Batch) -> list[Path]:
    paths = [batch.folder.settings, batch.folder.table, *own_files(batch.folder, batch.settings)]
    if batch.mat is not None:
        paths.append(batch.folder.mat)
    return paths + [path for row in batch.rows for path in batch.folder.fruit(row.fruit_id).input_files()]

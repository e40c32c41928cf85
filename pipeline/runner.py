"""Many fruits at once: one process per fruit, a time limit, and a crash that costs that fruit only."""

import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures import wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pebble import ProcessExpired, ProcessPool

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


@dataclass(frozen=True)
class Progressed:
    """A fruit has begun a stage."""

    fruit_id: str
    stage: str


@dataclass(frozen=True)
class Finished:
    """A fruit's process has ended; `result` is what it returned, or the exception that ended it."""

    fruit_id: str
    result: Any


@dataclass(frozen=True)
class Died:
    """A fruit's process died (a signal, or the kernel's out-of-memory killer)."""

    fruit_id: str
    exit_code: int | None


@dataclass(frozen=True)
class TimedOut:
    """A fruit's process was stopped at the time limit."""

    fruit_id: str


Event = Progressed | Finished | Died | TimedOut
Report = Callable[[str], None]


def run_fruits(
    work: Callable[[Any, Report], Any],
    tasks: Sequence[tuple[str, Any]],
    *,
    jobs: int,
    time_limit_s: float,
) -> Generator[Event, None, None]:
    """Runs `work(task, report)` for each (fruit_id, task) and yields what happens as it happens.

    Every fruit has a fresh process (spawned, so that no native library meets a forked copy of itself) with
    one numerical thread. Each process tells its stages in a file of its own: whatever kills one, no lock is
    left held. Leaving the iterator early stops what is running.
    """
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory(prefix="drupe-") as scratch,
        ProcessPool(max_workers=jobs, max_tasks=1, context=context, initializer=_watch) as pool,
    ):
        diaries = {Path(scratch) / str(i): fruit_id for i, (fruit_id, _) in enumerate(tasks)}
        pending = {
            pool.schedule(_work, args=(work, diary, task), timeout=time_limit_s): fruit_id
            for diary, (fruit_id, task) in zip(diaries, tasks, strict=True)
        }
        told = dict.fromkeys(diaries, 0)
        try:
            while pending:
                done, _ = wait(pending, timeout=0.1, return_when="FIRST_COMPLETED")
                for diary, fruit_id in diaries.items():
                    stages = diary.read_text().splitlines() if diary.exists() else []
                    yield from (Progressed(fruit_id, stage) for stage in stages[told[diary] :])
                    told[diary] = len(stages)
                for future in done:
                    yield _ending(pending.pop(future), future)
        finally:
            if pending:
                pool.stop()


def _ending(fruit_id: str, future: Any) -> Event:
    try:
        return Finished(fruit_id, future.result())
    except FutureTimeout:
        return TimedOut(fruit_id)
    except ProcessExpired as error:
        return Died(fruit_id, error.exitcode)
    except Exception as error:  # noqa: BLE001 - whatever a fruit raised costs that fruit only
        return Finished(fruit_id, error)


def _watch() -> None:
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    """Ends this process when its parent is gone: a killed run leaves no work that nobody waits for."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _work(work: Callable[[Any, Report], Any], diary: Path, task: Any) -> Any:
    def report(stage: str) -> None:
        with diary.open("a") as file:
            file.write(f"{stage}\n")

    return work(task, report)

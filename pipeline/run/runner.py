"""Many fruits at once: one process per fruit, a time limit, and a crash that costs that fruit only."""

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from pebble import ProcessExpired
from pebble.concurrent import process

from pipeline.files.scratch import scratch, temporary_files_in
from pipeline.safe_start import library_path, python_path

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


PROCESS = "drupe fruit"


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
    one numerical thread, in an empty folder: nothing of the caller's current folder is imported or read, and
    paths in tasks must be absolute. It shares no queue and no lock with the others, and tells its stages in a
    file of its own: one that is killed, at whatever moment, costs its fruit and holds up nobody. The time
    limit goes by a clock that nobody sets. Leaving the iterator early kills what is running; a killed caller
    takes its processes along. Ctrl-C is the caller's alone: a terminal sends it to the processes too.
    """
    with (
        scratch() as folder,
        temporary_files_in(_made(folder / "tmp")),
        _environment(
            {
                **dict.fromkeys(THREAD_VARIABLES, "1"),
                "PYTHONSAFEPATH": "1",
                "PYTHONPATH": python_path(),
                "LD_LIBRARY_PATH": library_path(),
            }
        ),
    ):
        empty = _made(folder / "empty")
        waiting = [
            (_Running(fruit_id, folder / f"log-{i}", f"{PROCESS} {i}"), task)
            for i, (fruit_id, task) in enumerate(tasks)
        ][::-1]
        pending: dict[Any, _Running] = {}
        try:
            while waiting or pending:
                while waiting and len(pending) < jobs:
                    one, task = waiting.pop()
                    try:
                        pending[_started(work, one, task, empty)] = one
                    except OSError:  # killed before it had been told its task, or no process can be made
                        yield Died(one.fruit_id, None)
                done, _ = wait(pending, timeout=0.1, return_when="FIRST_COMPLETED")
                for one in pending.values():
                    yield from (Progressed(one.fruit_id, stage) for stage in one.news())
                for future in done:
                    one = pending.pop(future)
                    yield _ending(one.fruit_id, future)
                for future in [f for f, one in pending.items() if one.out_of_time(time_limit_s)]:
                    one = pending.pop(future)
                    _kill(one)
                    yield TimedOut(one.fruit_id)
        finally:
            for one in pending.values():
                _kill(one)


def _started(work: Callable[[Any, Report], Any], one: "_Running", task: Any, folder: Path) -> Any:
    """The future of a fruit's process, which is running."""
    run = process(name=one.process, daemon=False, context=multiprocessing.get_context("spawn"))(_fruit)
    with _deaf_to_ctrl_c():
        return run(os.getpid(), folder, one.log, pickle.dumps((work, task)))


def _kill(one: "_Running") -> None:
    """Ends the process of a fruit. Asking (SIGTERM) is not enough: METIS takes that for a failure of its own
    (`signal(SIGTERM, gk_sigthrow)` in GKlib's error.c), and the work would go on and write a false record.
    """
    for child in multiprocessing.active_children():
        if child.name == one.process:
            child.kill()
            child.join()


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Processes started inside the block never get SIGINT; one that comes meanwhile is ours after it."""
    resource_tracker.ensure_running()  # started with the first process it would lift the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@dataclass
class _Running:
    """A fruit's process by its name, and how much of its log has been reported."""

    fruit_id: str
    log: Path
    process: str
    reported: int = 0
    since_s: float | None = None

    def news(self) -> list[str]:
        """The stages begun since the last call."""
        lines = self.log.read_text().split("\n")[:-1] if self.log.exists() else []
        stages = lines[self.reported :]
        self.reported += len(stages)
        return stages

    def out_of_time(self, limit_s: float) -> bool:
        """Whether it has been running for longer than `limit_s`, since this was first asked."""
        now = time.monotonic()
        self.since_s = now if self.since_s is None else self.since_s
        return now - self.since_s > limit_s


def _ending(fruit_id: str, future: Any) -> Event:
    try:
        return Finished(fruit_id, future.result())
    except ProcessExpired as error:
        return Died(fruit_id, error.exitcode)
    except Exception as error:  # noqa: BLE001 - whatever a fruit raised costs that fruit only
        return Finished(fruit_id, error)


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


@contextmanager
def _environment(values: Mapping[str, str | None]) -> Iterator[None]:
    """Variables that processes started inside the block find; None: which they do not."""
    before = {name: os.environ.get(name) for name in values}
    _set(values)
    try:
        yield
    finally:
        _set(before)


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _begin(parent: int, folder: Path) -> None:
    """A fruit's process begins: it ends with its parent, and leaves the caller's folder before it imports."""
    _die_with_parent()
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    sys.path[:] = [str(Path(entry).absolute()) if Path(entry).is_dir() else entry for entry in sys.path]
    os.chdir(folder)


def _die_with_parent() -> None:
    """Linux kills this process when the thread that started it ends, native code or not."""
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL, 0, 0, 0)


def _end_with(parent: int) -> None:
    """Ends this process when its parent is gone: a killed run leaves no work that nobody waits for."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _fruit(parent: int, folder: Path, log: Path, packed: bytes) -> Any:
    """What a fruit's process does: `packed` is opened, and imports what it needs, in the empty folder."""
    _begin(parent, folder)
    work, task = pickle.loads(packed)

    def report(line: str) -> None:
        with suppress(OSError), log.open("a") as file:  # a full disk costs the line, not the fruit
            file.write(f"{line}\n")

    return work(task, report)

"""Grades many fruits at once on this machine. Each has its own process and time limit, so that a crash costs
only its fruit.
"""

import ctypes
import gc
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import wait
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pebble import ProcessExpired
from pebble.concurrent import process

from pipeline.batch.scratch import environment, scratch, temporary_files_in
from pipeline.lack_of_memory import IN_WORDS
from pipeline.run.scheduling import Died, Event, Finished, Noted, Progressed, TimedOut
from pipeline.safe_start import uncollected

if TYPE_CHECKING:
    from pipeline.batch.records import FruitRecord
    from pipeline.batch.task import FruitTask

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
PROCESS = "drupe fruit"
LOOK_S = 0.1
"""Seconds between two reads of what the fruit's processes report."""
LAST_LINES = 5
"""Last lines of libraries that may name the cause of an end: libraries report one in one to three lines."""
MOST_BYTES = 2**20
"""Most bytes of a fruit's libraries that are passed on; drupe empties their file when it is larger."""
LEFT_OUT = f"libraries wrote more than {MOST_BYTES / 2**20:g} MiB; drupe left out the rest"
"""The last line that is passed on of a fruit's libraries, in place of all later ones."""


class LocalPool:
    """Processes of this machine, as many at once as `jobs`.

    Every fruit has a fresh process with one numerical thread in an empty folder. It is spawned, so that no
    native library meets a forked copy of itself. It imports and reads nothing from the caller's current
    folder: paths in tasks must be absolute. It shares no queue or lock with the others, and reports its
    stages in its own file: a killed process costs only its fruit. The time limit uses the monotonic clock;
    `most_MiB` limits the memory of a fruit's process. Leaving the pool kills running processes, and they die
    with a killed caller. They ignore Ctrl-C, which a terminal sends to them too: the caller handles it.
    """

    def __init__(self, *, jobs: int, time_limit_s: float, most_MiB: float | None = None) -> None:
        self._jobs, self._time_limit_s, self._most_MiB = jobs, time_limit_s, most_MiB
        self._held = ExitStack()
        self._pending: dict[Any, _Running] = {}
        self._begun = 0

    def __enter__(self) -> Self:
        """Makes the folders of the fruit's processes. Raises BatchRefused if it cannot."""
        with ExitStack() as held:
            self._folder = held.enter_context(scratch())
            held.enter_context(temporary_files_in(_made(self._folder / "tmp")))
            held.enter_context(environment({**dict.fromkeys(THREAD_VARIABLES, "1"), "PYTHONSAFEPATH": "1"}))
            self._empty = _made(self._folder / "empty")
            self._held = held.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with self._held:
            for fruit_process in self._pending.values():
                _kill(fruit_process)
            self._pending.clear()

    def room(self) -> int:
        """How many more fruit it takes now."""
        return self._jobs - len(self._pending)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Starts a fruit's process; raises OSError if it cannot."""
        number, self._begun = self._begun, self._begun + 1
        fruit_process = _Running(fruit_id, self._folder / f"log-{number}", f"{PROCESS} {number}")
        self._pending[_started(packed, fruit_process, self._empty)] = fruit_process

    def happened(self) -> Iterator[Event]:
        """Stages and endings since the last call."""
        done, _ = wait(self._pending, timeout=LOOK_S, return_when="FIRST_COMPLETED")
        for fruit_process in self._pending.values():
            yield from fruit_process.happened()
        for future in done:
            fruit_process = self._pending.pop(future)
            yield from fruit_process.happened()
            fruit_process.log.unlink(missing_ok=True)
            fruit_process.output.unlink(missing_ok=True)
            yield _ending(fruit_process, future)
        for future, fruit_process in list(self._pending.items()):
            if fruit_process.out_of_time(self._time_limit_s):
                yield self._killed(future, TimedOut(fruit_process.fruit_id))
            elif self._most_MiB is not None and _memory_MiB(fruit_process) > self._most_MiB:
                beyond = MemoryError(f"more than the {self._most_MiB:.0f} MiB limit per fruit")
                yield self._killed(future, Finished(fruit_process.fruit_id, beyond))

    def _killed(self, future: Any, ending: Event) -> Event:
        _kill(self._pending.pop(future))
        return ending


def _memory_MiB(fruit_process: "_Running") -> float:
    """Memory of a fruit's process in MiB; 0 if the system does not report it."""
    with suppress(OSError, ValueError, IndexError):
        for child in fruit_process.children():
            pages = int(Path(f"/proc/{child.pid}/statm").read_text().split()[1])
            return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return 0.0


def _started(packed: bytes, fruit_process: "_Running", folder: Path) -> Any:
    run = process(name=fruit_process.process, daemon=False, context=multiprocessing.get_context("spawn"))(
        _fruit
    )
    with _deaf_to_ctrl_c():
        return run(os.getpid(), folder, fruit_process.log, fruit_process.output, packed)


def _kill(fruit_process: "_Running") -> None:
    """Kills the process of a fruit. SIGTERM is not enough: METIS treats it as its own failure
    (`signal(SIGTERM, gk_sigthrow)` in GKlib's error.c), so the process would go on and write a false record.
    """
    for child in fruit_process.children():
        child.kill()
        child.join()


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Processes started inside the block never get SIGINT; this process gets it after the block."""
    resource_tracker.ensure_running()  # if it started with the first process, it would lift the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Running:
    """A fruit's process, and how much of its logs has been reported."""

    def __init__(self, fruit_id: str, log: Path, process: str) -> None:
        self.fruit_id, self.process = fruit_id, process
        self.log, self.output = log, log.with_name(f"{log.name}-libraries")
        self.since_s: float | None = None
        self._stages, self._lines = LinesOf(self.log), LinesOf(self.output)
        self._last: deque[str] = deque(maxlen=LAST_LINES)
        self._noted = 0

    def children(self) -> list[BaseProcess]:
        """The process while it is alive; else empty."""
        return [child for child in multiprocessing.active_children() if child.name == self.process]

    @property
    def lacked_memory(self) -> str:
        """The line in which a library reported a lack of memory at the end; empty if none did."""
        return next((line for line in reversed(self._last) if IN_WORDS.search(line)), "")

    def happened(self) -> list[Event]:
        """The stages begun, and what libraries wrote, since the last call."""
        stages = self._stages.new()
        lines = [line for line in self._lines.new() if line.strip()]
        self._last.extend(lines)
        return [
            *(Progressed(self.fruit_id, stage) for stage in stages),
            *(Noted(self.fruit_id, line) for line in self._within_limit(lines)),
        ]

    def _within_limit(self, lines: list[str]) -> Iterator[str]:
        """The lines until those of the fruit exceed MOST_BYTES, and then LEFT_OUT once."""
        for line in lines:
            if self._noted <= MOST_BYTES:
                self._noted += len(line)
                yield line if self._noted <= MOST_BYTES else LEFT_OUT

    def out_of_time(self, limit_s: float) -> bool:
        """Whether it has run for longer than `limit_s` since the first call."""
        now = time.monotonic()
        self.since_s = now if self.since_s is None else self.since_s
        return now - self.since_s > limit_s


class LinesOf:
    """Lines that another process appends to a file; empties the file once it is larger than MOST_BYTES."""

    def __init__(self, path: Path) -> None:
        self.path, self._at = path, 0

    def new(self) -> list[str]:
        """The whole lines since the last call, from the last MOST_BYTES; empty if there is no file."""
        try:
            with self.path.open("r+b") as file:
                end = file.seek(0, os.SEEK_END)
                self._at = file.seek(max(self._at, end - MOST_BYTES))
                said = file.read(MOST_BYTES)
                whole = said[: said.rfind(b"\n") + 1]
                self._at += len(whole)
                if self._at > MOST_BYTES:
                    file.truncate(0)  # the other process appends to the new end
                    self._at = 0
        except FileNotFoundError:
            return []
        return whole.decode(errors="replace").splitlines()


def _ending(fruit_process: _Running, future: Any) -> Event:
    fruit_id = fruit_process.fruit_id
    try:
        return Finished(fruit_id, future.result())
    except ProcessExpired as error:
        if fruit_process.lacked_memory:
            return Finished(fruit_id, MemoryError(fruit_process.lacked_memory))
        return Died(fruit_id, error.exitcode)
    except Exception as error:  # noqa: BLE001 - whatever a fruit raised costs that fruit only
        return Finished(fruit_id, error)


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _begin(parent: int, folder: Path) -> None:
    """Prepares a fruit's process: it ends with its parent, and leaves the caller's folder before imports."""
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
    """Ends this process when its parent is gone, so that a killed run leaves no useless work."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _write_into(path: Path) -> None:
    """Appends all that libraries write, log and warn to a file, for the rest of this process."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.close(descriptor)
    logging.basicConfig(format="%(name)s: %(message)s", stream=sys.stderr)
    logging.captureWarnings(True)


def _fruit(parent: int, folder: Path, log: Path, output: Path, packed: bytes) -> Any:
    """Main function of a fruit's process; unpickles `packed`, with its imports, in the empty folder."""
    with suppress(OSError):  # a full disk costs the lines of libraries, not the fruit
        _write_into(output)
    _begin(parent, folder)
    with uncollected():
        work, task = pickle.loads(packed)

    def report(line: str) -> None:
        with (
            suppress(OSError),  # a full disk costs the line, not the fruit
            log.open("a", encoding="utf-8", errors="backslashreplace") as file,  # names may be no UTF-8
        ):
            file.write(f"{line}\n")

    return work(task, report)


def work_on(task: "FruitTask", report: Callable[[str], None]) -> "FruitRecord":
    """The work of a fruit's process in a run: grades the fruit, writes and returns its record.

    The process that hands out fruit never runs this function, so the function imports what it needs.
    """
    with uncollected():
        from pipeline.fruit.stages import grade_fruit

    gc.freeze()  # imports stay until the process ends: garbage collection skips them
    return grade_fruit(task, report)

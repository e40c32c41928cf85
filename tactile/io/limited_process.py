"""Reading with limits: in a process of its own first, or with a limit on this process's memory.

Native libraries believe what a file says of itself. One changed byte can make them loop for ever, and a file
of 1 kB can make them ask for 500 GB, at which some of them end the whole process.
"""

import ctypes
import faulthandler
import math
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

try:
    import resource
except ModuleNotFoundError:  # where processes cannot be forked either
    resource = None  # type: ignore[assignment]

PR_SET_PDEATHSIG = 1
"""Of prctl(2): the signal that a process gets when the thread that made it ends."""
LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
"""Opened here, since a forked process should open nothing but the file."""
MOST_ANSWER_BYTES = 60_000
"""What a pipe takes while nobody reads it."""
_NO_MEMORY, _BROKEN = 3, 4
"""Exit statuses of the process."""


class TrialEnding(Enum):
    """How a trial ended."""

    DONE = auto()
    TOO_LONG = auto()
    TOO_LARGE = auto()
    """More memory than the limit, or an end by a signal: some libraries abort where memory is refused."""


@dataclass(frozen=True)
class Trial:
    """How it ended, and the lines that it wrote until then."""

    ending: TrialEnding
    lines: tuple[str, ...] = ()


def tried(action: Callable[[Callable[[str], None]], None], *, patience_s: float, most_bytes: int) -> Trial:
    """Runs `action` in a process of its own, which may take `patience_s` and `most_bytes` more memory.

    The action gets a function that takes lines for the caller. An exception of the action counts as DONE: the
    reader will meet it too. So does a system that cannot fork processes. The process ends with this one,
    however that ends: at an exception here, by the kernel when this process is killed (Linux), and after
    `patience_s` of processor time in any case.
    """
    if not hasattr(os, "fork"):
        return Trial(TrialEnding.DONE)
    parent = os.getpid()
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child touches none of them
        child = os.fork()
    if child == 0:
        _act(action, writer, parent, patience_s, most_bytes)
    os.close(writer)
    status = None
    try:
        end = time.monotonic() + patience_s
        while (status := _status(child)) is None and time.monotonic() < end:
            time.sleep(0.002)
    finally:
        if status is None:
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
        with os.fdopen(reader, "rb") as pipe:
            said = pipe.read(MOST_ANSWER_BYTES) if status is not None else b""
    if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)):
        return Trial(TrialEnding.TOO_LONG)
    lines = tuple(said.decode(errors="replace").splitlines())
    return Trial(TrialEnding.DONE if status == 0 else TrialEnding.TOO_LARGE, lines)


@contextmanager
def limited_memory(most_bytes: int) -> Iterator[None]:
    """Inside the block this process gets at most `most_bytes` more memory; more ends in an exception.

    The limit is on addresses (RLIMIT_AS) of the whole process, so that its other threads have it too. The
    widest of the blocks that are open at the same time counts, and the last one to end lifts the limit. Only
    Linux says how many addresses are in use; elsewhere there is no limit.
    """
    if resource is None or sys.platform != "linux":
        yield
        return
    _BLOCKS.begin(_addresses_in_use() + most_bytes)
    try:
        yield
    finally:
        _BLOCKS.end()


class _Blocks:
    """The blocks of `limited_memory` that are open, in all threads."""

    def __init__(self) -> None:
        self._lock, self._open, self._before = threading.Lock(), 0, math.inf
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(
                before=self._lock.acquire, after_in_parent=self._lock.release, after_in_child=self._forget
            )

    def begin(self, most: float) -> None:
        """Sets the limit, within the one before the first block."""
        with self._lock:
            now = _limit()
            self._before = now if self._open == 0 else self._before
            _set_limit(min(most if self._open == 0 else max(most, now), self._before))
            self._open += 1

    def end(self) -> None:
        """After the last block the limit is as before, or wider where somebody else has widened it."""
        with self._lock:
            self._open = max(self._open - 1, 0)
            if self._open == 0:
                _set_limit(max(self._before, _limit()))

    def _forget(self) -> None:
        """A forked process has none of the threads in which blocks are open."""
        if self._open:
            _set_limit(self._before)
        self._open = 0
        self._lock.release()


def _limit() -> float:
    """Bytes of addresses; infinite without a limit."""
    now, _ = resource.getrlimit(resource.RLIMIT_AS)
    return math.inf if now == resource.RLIM_INFINITY else now


def _set_limit(most: float) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY if most == math.inf else int(most), hard))


def lacks_memory(cause: BaseException) -> bool:
    """Whether it was raised for want of memory; HDF5 says so in words alone."""
    return isinstance(cause, MemoryError) or "allocat" in str(cause).lower()


def _act(
    action: Callable[[Callable[[str], None]], None],
    writer: int,
    parent: int,
    patience_s: float,
    most_bytes: int,
) -> None:
    """The life of the process; never returns."""
    status = _BROKEN
    try:
        faulthandler.disable()
        quiet = os.open(os.devnull, os.O_RDWR)
        for handle in (0, 1, 2):
            os.dup2(quiet, handle)
        _end_with(parent, patience_s)
        with limited_memory(most_bytes):
            action(lambda line: _write_line(writer, line))
        status = 0
    except Exception as cause:  # noqa: BLE001 - whatever it is, the reader will meet it too
        status = _NO_MEMORY if lacks_memory(cause) else 0
    finally:
        os._exit(status)


def _write_line(writer: int, line: str) -> None:
    os.write(writer, f"{line}\n".encode(errors="replace"))


def _status(child: int) -> int | None:
    """The wait status of a process that has ended; None before.

    0 also where the kernel has forgotten the process already, since this one ignores SIGCHLD.
    """
    try:
        ended, status = os.waitpid(child, os.WNOHANG)
    except ChildProcessError:
        return 0
    return status if ended else None


def _end_with(parent: int, patience_s: float) -> None:
    """This process, the child, ends when its parent does, and when its time is up; it leaves no core."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_s = math.ceil(patience_s) + 1
    hard_s = resource.getrlimit(resource.RLIMIT_CPU)[1]
    if hard_s == resource.RLIM_INFINITY or hard_s > limit_s:
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
    if LIBC is not None:
        LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:  # it ended before the kernel was told
            os._exit(1)


def _addresses_in_use() -> int:
    """Bytes, from /proc (Linux)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")


_BLOCKS = _Blocks()

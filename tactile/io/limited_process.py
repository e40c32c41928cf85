"""Reading with limits on time and memory, in a process of its own first.

Native libraries believe what a file says of itself. One changed byte can make them loop for ever, and a file
of 1 kB can make them ask for 500 GB, at which some of them end the whole process.
"""

import ctypes
import faulthandler
import math
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, auto

from pipeline.files.limited_memory import limited_memory

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

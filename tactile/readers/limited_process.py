"""Reads files with limits on time and memory in a separate process, before this one reads them.

Native libraries trust a file's contents. One changed byte can make them loop for ever. A file of 1 kB can
make them request 500 GB, at which some end the whole process.
"""

import faulthandler
import math
import os
import select
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn, TypeAlias

from pipeline.files.limited_memory import limited_memory
from pipeline.files.plain_file import size

try:
    import resource
except ModuleNotFoundError:  # where processes cannot be forked either
    resource = None  # type: ignore[assignment]

DONE = b"\0"
"""The last byte that the process writes."""
Action: TypeAlias = Callable[[Callable[[str], None]], object]


@dataclass(frozen=True)
class Trial:
    """`exceeded`: the limit that the process met, in words; empty if it ended itself. `lines`: its output."""

    exceeded: str
    lines: tuple[str, ...]


def tried(action: Action, *, patience_s: float, most_bytes: int) -> Trial:
    """Runs `action` in a separate process, which may take `patience_s` and `most_bytes` more memory.

    The action gets a function that sends lines to the caller. Its exceptions exceed no limit, since the
    reader will raise them too. Without fork nothing runs or exceeds a limit. A signal that ends the process
    counts as exceeded memory: some libraries abort if it is refused. The process ends with the call, and
    after `patience_s` of processor time in any case.
    """
    if not hasattr(os, "fork"):
        return Trial("", ())
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child touches none of them
        child = os.fork()
    if child == 0:
        _act(action, writer, patience_s, most_bytes)
    os.close(writer)
    said, end = b"", time.monotonic() + patience_s
    try:
        while in_time := bool(select.select([reader], [], [], max(end - time.monotonic(), 0.0))[0]):
            if not (more := os.read(reader, 65_536)):
                break
            said += more
    finally:
        os.close(reader)
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    lines = tuple(said.rstrip(DONE).decode(errors="replace").splitlines())
    if not in_time:
        return Trial(f"{patience_s:.0f} s", lines)
    return Trial("" if said.endswith(DONE) else f"{size(most_bytes)} of memory", lines)


def lacks_memory(cause: BaseException) -> bool:
    """Whether memory was too small; HDF5 reports this only in words."""
    return isinstance(cause, MemoryError) or "allocat" in str(cause).lower()


def _act(action: Action, writer: int, patience_s: float, most_bytes: int) -> NoReturn:
    """Runs the action in the child process."""
    try:
        faulthandler.disable()
        quiet = os.open(os.devnull, os.O_RDWR)
        for handle in (0, 1, 2):
            os.dup2(quiet, handle)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        limit_s, hard_s = math.ceil(patience_s) + 1, resource.getrlimit(resource.RLIMIT_CPU)[1]
        if hard_s == resource.RLIM_INFINITY or hard_s > limit_s:
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
        with limited_memory(most_bytes):
            action(lambda line: _write(writer, f"{line}\n".encode(errors="replace")))
        _write(writer, DONE)
    except Exception as cause:  # noqa: BLE001 - whatever it is, the reader will meet it too
        if not lacks_memory(cause):
            _write(writer, DONE)
    finally:
        os._exit(0)


def _write(writer: int, data: bytes) -> None:
    os.write(writer, data)

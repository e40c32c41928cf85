"""A limit on this process's memory while a native library reads a file of unknown origin."""

import math
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import resource
except ModuleNotFoundError:
    resource = None  # type: ignore[assignment]

SHARE_OF_FREE = 0.75
"""Of the machine's free memory, that one run of a model may take. Set by hand."""


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


def _addresses_in_use() -> int:
    """Bytes, from /proc (Linux)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")


def free_bytes() -> int:
    """What the machine's memory has room for (Linux); 1 TB where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        return 10**12


_BLOCKS = _Blocks()

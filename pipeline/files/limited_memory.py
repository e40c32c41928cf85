"""This process's memory: a limit while a native library reads a file, and what is freed given back."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import resource
except ModuleNotFoundError:
    resource = None  # type: ignore[assignment]

SHARE_OF_FREE = 0.75
"""Of the machine's free memory, that one run of a model may take. Set by hand."""
_before: list[tuple[int, int]] = []
"""For each block that is open, in any thread, the limit before the first of them."""


@contextmanager
def limited_memory(most_bytes: int) -> Iterator[None]:
    """Inside the block this process gets at most `most_bytes` more memory; more ends in an exception.

    The limit is on addresses (RLIMIT_AS) of the whole process, so that its other threads have it too. Only
    Linux says how many addresses are in use; elsewhere there is no limit.
    """
    if resource is None or sys.platform != "linux":
        yield
        return
    before = _before[0] if _before else resource.getrlimit(resource.RLIMIT_AS)
    _before.append(before)
    (soft, hard), most = before, _addresses_in_use() + most_bytes
    most = most if soft == resource.RLIM_INFINITY else min(most, soft)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    try:
        yield
    finally:
        _before.pop()
        resource.setrlimit(resource.RLIMIT_AS, before)


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


def return_freed_memory() -> None:
    """Gives freed memory back to the system; only glibc keeps some 400 MiB of it after photos."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)

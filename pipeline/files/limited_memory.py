"""This process's memory: a limit for native libraries, and the return of freed memory to the system."""

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
"""Share of the machine's free memory that one run of a model may take. Set by hand."""
_before: list[tuple[int, int]] = []
"""One entry for each open block, in any thread: the limits (soft, hard) before the first of them."""


@contextmanager
def limited_memory(most_bytes: int) -> Iterator[None]:
    """Inside the block this process can allocate at most `most_bytes` more; a larger request raises an error.

    The limit is on the address space (RLIMIT_AS) of the whole process, so its other threads have it too. Only
    Linux reports the address space in use; elsewhere there is no limit.
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
    """Size of this process's address space in bytes, from /proc (Linux)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")


def free_bytes() -> int:
    """Free memory of the machine in bytes (Linux); 1 TB if the system does not report it."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        return 10**12


def return_freed_memory() -> None:
    """Returns freed memory to the system (Linux): after photos, glibc keeps some 400 MiB of it."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)

"""A limit on this process's memory while a native library works on a stranger's file.

The same rule as tactile.io.limited_process's: the rooms do not import each other.
"""

import os
import sys
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

    The limit is on addresses (RLIMIT_AS). Only Linux says how many are in use; elsewhere there is no limit.
    """
    if resource is None or sys.platform != "linux":
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = _addresses_in_use() + most_bytes
    lower = before[0] == resource.RLIM_INFINITY or most < before[0]
    if lower:
        resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        if lower:
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

"""This process's memory: a limit for native libraries, and the return of freed memory to the system."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock

try:
    import resource
except ModuleNotFoundError:
    resource = None  # type: ignore[assignment]

_USER = "user"
_limits: dict[object, int] = {}
"""Soft limits in bytes of address space: the user's (_USER), and that of each open block, in any thread."""
_changing = Lock()


@contextmanager
def limited_memory(most_bytes: int) -> Iterator[None]:
    """Inside the block this process can allocate at most `most_bytes` more; a larger request raises an error.

    The limit is on the address space (RLIMIT_AS) of the whole process, so its other threads have it too. The
    tightest of the open blocks holds. A forked process starts without its parent's blocks. Only Linux reports
    the address space in use; elsewhere there is no limit.
    """
    if resource is None or sys.platform != "linux":
        yield
        return
    block, most = object(), _addresses_in_use() + most_bytes
    try:
        with _changing:
            if len(_limits) <= 1:
                _limits[_USER] = resource.getrlimit(resource.RLIMIT_AS)[0]
            _limits[block] = most
            _set_tightest()
        yield
    finally:
        with _changing:
            if _limits.pop(block, None) is not None:
                _set_tightest()


def _set_tightest() -> None:
    finite = [most for most in _limits.values() if most != resource.RLIM_INFINITY]
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (min(finite, default=resource.RLIM_INFINITY), hard))


def _forget_blocks() -> None:
    """In a forked process: its parent's threads, which would end the blocks, do not exist here."""
    try:
        if len(_limits) > 1:
            user = _limits[_USER]
            _limits.clear()
            _limits[_USER] = user
            _set_tightest()
    finally:
        _changing.release()


if sys.platform != "win32":
    os.register_at_fork(
        before=_changing.acquire, after_in_parent=_changing.release, after_in_child=_forget_blocks
    )


def _addresses_in_use() -> int:
    """Size of this process's address space in bytes, from /proc (Linux)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")


def return_freed_memory() -> None:
    """Returns freed memory to the system (Linux): after photos, glibc keeps some 400 MiB of it."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)

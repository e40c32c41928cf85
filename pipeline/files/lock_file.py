"""Empty files that a process locks; the operating system releases the lock however the process ends."""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

WAIT_S = 30.0
"""Seconds that a process waits for the lock; writing one file takes less than one. Set by hand."""
LOOK_S = 0.01
"""Seconds between two attempts to lock the file."""


@contextmanager
def lock_of(path: Path, *, wait_s: float = WAIT_S) -> Iterator[bool]:
    """Inside the block this process holds the lock of the file at `path`; creates the file if it is missing.

    Yields False if another process still holds the lock after `wait_s`, else True. A file system without
    locks yields True at once. Raises OSError if the file cannot be created, or if `path` is a link.
    """
    until = time.monotonic() + wait_s
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o660)
        try:
            held = locked(lock)
            if held and not _is_at(lock, path):
                continue  # another process removed the file before this lock: it excludes nobody
            if held or time.monotonic() > until:
                yield held
                return
        finally:
            os.close(lock)
        time.sleep(LOOK_S)


def locked(lock: int) -> bool:
    """Locks an open file. False if another process holds it; True if the file system has no locks."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _is_at(lock: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(lock), path.lstat())
    except OSError:
        return False

"""Empty files that a process locks; the operating system lets go of them however the process ends."""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

WAIT_S = 30.0
"""Seconds that a process waits for another, which takes less than one for each file. Set by hand."""
LOOK_S = 0.01
"""Seconds between two looks whether the lock is free."""


@contextmanager
def lock_of(path: Path, *, wait_s: float = WAIT_S) -> Iterator[bool]:
    """Inside the block this process holds the lock of the file at `path`, which is made where there is none.

    Gives whether it does: False where another still holds it after `wait_s`. A file system without locks has
    nobody to wait for. No link is followed. Raises OSError where the file cannot be made.
    """
    until = time.monotonic() + wait_s
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o660)
        try:
            held = locked(lock)
            if held and not _is_at(lock, path):
                continue  # removed before it was locked: it keeps nobody out
            if held or time.monotonic() > until:
                yield held
                return
        finally:
            os.close(lock)
        time.sleep(LOOK_S)


def locked(lock: int) -> bool:
    """Locks an open file, unless another holds it; a file system without locks has nobody to wait for."""
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

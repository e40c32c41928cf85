"""Empty files that a process locks; the operating system lets go of them however the process ends."""

import fcntl
import os
import stat
from pathlib import Path


def open_lock(path: Path) -> int:
    """A descriptor of the file, which is made where there is none; raises OSError. No link is followed."""
    return os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)


def locked(lock: int) -> bool:
    """Locks an open file, unless another holds it; a file system without locks has nobody to wait for."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def is_at(lock: int, path: Path) -> bool:
    """Whether an open file is still the one at `path`: it may have been removed before it was locked."""
    try:
        return os.path.samestat(os.fstat(lock), path.lstat())
    except OSError:
        return False


def is_lock_file(path: Path) -> bool:
    """Whether it is as a lock is left: a plain file that holds nothing."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISREG(status.st_mode) and status.st_size == 0

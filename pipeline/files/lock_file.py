"""Empty files that a process locks; the operating system lets go of them however the process ends."""

import fcntl
import os
import stat
import time
from contextlib import suppress
from pathlib import Path

WAIT_S = 30.0
"""Seconds that a process waits for another, which takes less than one for each file. Set by hand."""
LOOK_S = 0.01
"""Seconds between two looks whether the lock is free."""
LOCKS = Path("/proc/locks")
"""Linux's list of all locks: number, kind, ADVISORY, READ or WRITE, process, device and inode, range."""


def open_lock(path: Path) -> int:
    """A descriptor of the file, which is made where there is none; raises OSError. No link is followed.

    Who may not write the file may not read it either: a lock can be held by anyone who can open its file.
    """
    lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    mode = os.fstat(lock).st_mode & 0o777
    wanted = mode & ~(0o040 if not mode & 0o020 else 0) & ~(0o004 if not mode & 0o002 else 0)
    if mode != wanted:
        with suppress(OSError):  # a file of another user, or a file system without rights
            os.fchmod(lock, wanted)
    return lock


def locked(lock: int) -> bool:
    """Locks an open file, unless another holds it; a file system without locks has nobody to wait for."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def locked_within(lock: int, wait_s: float = WAIT_S) -> bool:
    """Locks an open file, and waits `wait_s` for another process that holds it; False where it still does."""
    until = time.monotonic() + wait_s
    while not locked(lock):
        if time.monotonic() > until:
            return False
        time.sleep(LOOK_S)
    return True


def holder_of(lock: int) -> str:
    """The process that holds an open file's lock, as " (process 12, python3, of user anna)".

    Empty where the system does not tell: not Linux, or a process of another machine or container.
    """
    status = os.fstat(lock)
    for line in _lines(LOCKS):
        words = line.split()
        if len(words) < 6 or words[1] != "FLOCK" or words[5].rpartition(":")[2] != str(status.st_ino):
            continue
        process = Path("/proc", words[4])
        name = "".join(_lines(process / "comm"))
        try:
            user = process.owner() if name else ""
        except (OSError, KeyError):
            user = ""
        known = [f"process {words[4]}", *([name] if name else []), *([f"of user {user}"] if user else [])]
        return f" ({', '.join(known)})" if words[4] != "0" else ""
    return ""


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []


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

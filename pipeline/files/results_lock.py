"""One run at a time writes into a results folder."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.problem import BatchRefused, Problem

LOCK = ".lock"


@contextmanager
def results_lock(root: Path, *, option: str = "--out") -> Iterator[None]:
    """Holds the results folder for this run; the operating system lets go of it however the run ends.

    Where the file system has no locks, two runs are not kept apart.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
        lock = os.open(root / LOCK, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except OSError as error:
        sentence = f"cannot be written ({error.strerror}); choose another place with {option}."
        raise BatchRefused([Problem(str(root), sentence)]) from None
    try:
        if not _taken(lock):
            sentence = f"another run is writing here; wait for it, or choose another {option}."
            raise BatchRefused([Problem(str(root), sentence)])
        yield
    finally:
        os.close(lock)


def is_held(root: Path) -> bool:
    """Whether another run is writing into the results folder `root`."""
    try:
        lock = os.open(root / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        return not _taken(lock)
    finally:
        os.close(lock)


def _taken(lock: int) -> bool:
    """Takes the lock, unless another process holds it; a file system without locks has nobody to wait for."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True

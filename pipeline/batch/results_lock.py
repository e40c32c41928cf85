"""One run at a time writes into a results folder."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.files.lock_file import holder_of, is_at, locked, open_lock
from pipeline.problem import refused

LOCK = ".lock"


@contextmanager
def results_lock(root: Path, *, option: str = "--out") -> Iterator[None]:
    """Holds the results folder for this run; the operating system lets go of it however the run ends.

    Where the file system has no locks, two runs are not kept apart.
    """
    try:
        lock = _locked_file(root)
    except OSError as error:
        sentence = f"cannot be written ({error.strerror}); choose another place with {option}."
        raise refused(root, sentence) from None
    if isinstance(lock, str):
        sentence = (
            f"another run is writing here{lock} and holds {LOCK}; wait for it, or choose another {option}."
        )
        raise refused(root, sentence)
    try:
        yield
    finally:
        os.close(lock)


def _locked_file(root: Path) -> int | str:
    """The open lock of `root`; where another run holds it, that run in brackets, or an empty text.

    One that `drupe clean` removed before it was locked keeps nobody out, and is made anew.
    """
    while True:
        root.mkdir(parents=True, exist_ok=True)
        lock = open_lock(root / LOCK)
        if not locked(lock):
            holder = holder_of(lock)
            os.close(lock)
            return holder
        if is_at(lock, root / LOCK):
            return lock
        os.close(lock)


def is_held(root: Path) -> bool:
    """Whether another run is writing into the results folder `root`."""
    try:
        lock = os.open(root / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        return not locked(lock)
    finally:
        os.close(lock)

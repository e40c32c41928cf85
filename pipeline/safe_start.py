"""Keeps drupe from running files of the current folder, which others may have put there.

Under -c and -m, Python puts the current folder first on its path. Matplotlib reads a `matplotlibrc` there at
import, and some wheels load shared libraries from there. Importing this module removes the folder from the
path, unless PYTHONPATH names it. drupe imports libraries inside `elsewhere`.
"""

import os
import sys


def _is_here(entry: str) -> bool:
    try:
        return entry == "" or os.path.samefile(entry, os.curdir)  # noqa: PTH121 - pathlib may not be ours yet
    except OSError:
        return False


_named = "" if sys.flags.ignore_environment else os.environ.get("PYTHONPATH", "")
_asked_for = any(entry and _is_here(entry) for entry in _named.split(os.pathsep))
if not sys.flags.safe_path and not _asked_for and _is_here(sys.path[0]):
    del sys.path[0]

import gc  # noqa: E402 - from here on imports are Python's own
from collections.abc import Iterator  # noqa: E402
from contextlib import contextmanager  # noqa: E402
from pathlib import Path  # noqa: E402

from pipeline.interruption import held_back  # noqa: E402


@contextmanager
def uncollected() -> Iterator[None]:
    """Inside the block Python collects no garbage. Libraries create hundreds of thousands of permanent
    objects at import; scanning them repeatedly takes a quarter of the import time.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@contextmanager
def elsewhere() -> Iterator[None]:
    """Inside the block the current folder is the package's own, and interruptions wait for its end.

    Importing OpenCV leaves an empty entry in LD_LIBRARY_PATH, by which later programs load libraries from the
    current folder. The end of the block removes it.
    """
    with held_back(), _own_folder(), uncollected():
        yield
    path = os.environ.pop("LD_LIBRARY_PATH", "")
    if entries := [entry for entry in path.split(os.pathsep) if entry]:
        os.environ["LD_LIBRARY_PATH"] = os.pathsep.join(entries)


@contextmanager
def _own_folder() -> Iterator[None]:
    """Inside the block the package's folder is the current one, unless the current one cannot be opened."""
    try:
        here = os.open(os.curdir, os.O_RDONLY)
    except OSError:
        yield
        return
    try:
        os.chdir(Path(__file__).resolve().parent)
        yield
    finally:
        os.fchdir(here)
        os.close(here)

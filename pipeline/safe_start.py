"""Nothing in the current folder is run: it may be a stranger's.

Python puts the current folder first on its path under -c and -m; Matplotlib reads a `matplotlibrc` there
while it is imported, and shared libraries are looked for there while some wheels are loaded. Importing this
module takes the folder off the path; `elsewhere` is where libraries are imported. What PYTHONPATH names
stays: it is the user's.
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
    """Inside the block Python does not look for garbage: libraries make hundreds of thousands of objects that
    stay, and looking through them again and again takes a quarter of the time of importing them.
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
    """Inside the block the current folder is the package's own, and an interruption waits for its end.

    OpenCV, once imported, leaves an empty entry in LD_LIBRARY_PATH to every program that is started
    afterwards, which means the current folder: it is removed.
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

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
import importlib  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from contextlib import contextmanager  # noqa: E402
from pathlib import Path  # noqa: E402

from pipeline.interruption import ends_at_once  # noqa: E402


def load(*libraries: str) -> None:
    """Imports what would be imported late, once the current folder is the caller's again."""
    for library in libraries:
        importlib.import_module(library)


def library_path() -> str | None:
    """LD_LIBRARY_PATH without empty entries, which mean the current folder; None where nothing is left.

    OpenCV, once imported, leaves one to every program that is started afterwards.
    """
    path = os.environ.get("LD_LIBRARY_PATH", "")
    return os.pathsep.join(entry for entry in path.split(os.pathsep) if entry) or None


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
    """Inside the block the current folder is the package's own; libraries are not looked for in it after.

    Libraries are loaded in it: an interruption ends the process there and then (`ends_at_once`).
    """
    try:
        with ends_at_once(), _elsewhere(), uncollected():
            yield
    finally:
        path = library_path()
        if path is None:
            os.environ.pop("LD_LIBRARY_PATH", None)
        else:
            os.environ["LD_LIBRARY_PATH"] = path


@contextmanager
def _elsewhere() -> Iterator[None]:
    """Within it the working folder is drupe's own, so that no module beside the user's files is imported."""
    try:
        here = os.open(os.curdir, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    except OSError:
        yield
        return
    try:
        os.chdir(Path(__file__).resolve().parent)
        yield
    finally:
        try:
            os.fchdir(here)
        finally:
            os.close(here)

"""Nothing in the current folder is run: it may be a stranger's.

Python puts the current folder first on its path under -c and -m; Matplotlib reads a `matplotlibrc` there
while it is imported, and shared libraries are looked for there while some wheels are loaded. Importing this
module takes the folder off the path; `elsewhere` is where libraries are imported. What PYTHONPATH names
stays: it is the user's own word.
"""

import os
import sys


def leave_current_folder_off_the_path() -> None:
    """Takes away the entry that -c or -m put first; in safe-path mode there is none."""
    if sys.path and not sys.flags.safe_path and _is_here(sys.path[0]):
        del sys.path[0]


def _is_here(entry: str) -> bool:
    try:
        return entry == "" or os.path.samefile(entry, os.curdir)  # noqa: PTH121 - pathlib may not be ours yet
    except OSError:
        return False


leave_current_folder_off_the_path()

import importlib  # noqa: E402 - from here on imports are Python's own
from collections.abc import Iterator  # noqa: E402
from contextlib import contextmanager  # noqa: E402
from pathlib import Path  # noqa: E402


def load(*libraries: str) -> None:
    """Imports what would be imported late, once the current folder is the caller's again."""
    for library in libraries:
        importlib.import_module(library)


def library_path() -> str | None:
    """LD_LIBRARY_PATH without empty entries, which mean the current folder; None where nothing is left.

    OpenCV, once imported, leaves one to every program that is started afterwards.
    """
    return ":".join(entry for entry in os.environ.get("LD_LIBRARY_PATH", "").split(":") if entry) or None


@contextmanager
def elsewhere() -> Iterator[None]:
    """Inside the block the current folder is the package's own; libraries are not looked for in it after."""
    try:
        with _elsewhere():
            yield
    finally:
        path = library_path()
        if path is None:
            os.environ.pop("LD_LIBRARY_PATH", None)
        else:
            os.environ["LD_LIBRARY_PATH"] = path


@contextmanager
def _elsewhere() -> Iterator[None]:
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

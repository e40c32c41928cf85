"""Folders for what a run needs only while it runs, and the end of those that killed runs left."""

import fcntl
import math
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.files.lock_file import locked_within, open_lock
from pipeline.problem import refused

PREFIX = "drupe-run-"
_LOCK = ".lock"


@contextmanager
def scratch(*, near: Path | None = None) -> Iterator[Path]:
    """A folder that is gone afterwards, in the temporary folder or as a hidden one beside `near`.

    It holds a lock while in use, whoever dies: the next call removes those that nobody holds. Raises
    BatchRefused where none can be made.
    """
    try:
        place = Path(tempfile.gettempdir()) if near is None else near.parent
        place.mkdir(parents=True, exist_ok=True)
        prefix = PREFIX if near is None else f".{near.name}.{PREFIX}"
        _sweep(place, prefix)
        folder, lock = _made(place, prefix)
    except OSError as error:
        where = "set TMPDIR to a folder that can be written" if near is None else "choose another place"
        sentence = f"no temporary folder can be made ({error.strerror}); free space there, or {where}."
        at = str(error.filename or "the temporary folder" if near is None else near.parent)
        raise refused(at, sentence) from None
    try:
        yield folder
    finally:
        _remove(folder)
        os.close(lock)


@contextmanager
def temporary_files_in(folder: Path) -> Iterator[None]:
    """Inside the block, temporary files of this process and of those it starts lie in `folder`."""
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        with environment({"TMPDIR": str(folder)}):
            yield
    finally:
        tempfile.tempdir = before


@contextmanager
def environment(values: Mapping[str, str | None]) -> Iterator[None]:
    """Variables that processes started inside the block find; None: which they do not."""
    before = dict(os.environ)
    os.environ.update({name: value for name, value in values.items() if value is not None})
    for name in [name for name, value in values.items() if value is None]:
        os.environ.pop(name, None)
    try:
        yield
    finally:
        for name in values:
            os.environ.pop(name, None)
        os.environ.update({name: before[name] for name in values if name in before})


def _made(place: Path, prefix: str) -> tuple[Path, int]:
    """A new folder and its lock, held; made again where a sweep took it before it was held."""
    while True:
        folder = Path(tempfile.mkdtemp(dir=place, prefix=prefix))
        try:
            lock = open_lock(folder / _LOCK)
        except FileNotFoundError:
            continue
        locked_within(lock, math.inf)
        if (folder / _LOCK).exists():
            return folder, lock
        os.close(lock)


def _sweep(place: Path, prefix: str) -> None:
    """Removes folders of killed runs: by name, a real folder, our own user's, with a lock nobody holds.

    A run killed just before it made its lock, or just after it removed it, left an empty folder.
    """
    ours = re.compile(re.escape(prefix) + r"[a-z0-9_]{8}")
    for folder in place.iterdir():
        if not ours.fullmatch(folder.name):
            continue
        with suppress(OSError):
            status = folder.lstat()
            if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
                continue
            try:
                lock = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            except FileNotFoundError:
                folder.rmdir()
                continue
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(folder)
            finally:
                os.close(lock)


def _remove(folder: Path) -> None:
    """Removes a folder of ours, its lock last: wherever a kill stops this, the next sweep can go on."""
    with suppress(OSError):
        for path in list(folder.iterdir()):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != _LOCK:
                with suppress(OSError):
                    path.unlink()
        if [path.name for path in folder.iterdir()] == [_LOCK]:
            (folder / _LOCK).unlink()
            folder.rmdir()


def moved_in(made: Path, target: Path) -> None:
    """A folder made elsewhere comes to its place. An empty folder there stays the one it is: a shell may be
    in it. batch.toml, which makes it a batch, comes last.
    """
    if not target.is_dir():
        made.rename(target)
        return
    for path in sorted(made.iterdir(), key=lambda path: path.name == "batch.toml"):
        path.rename(target / path.name)

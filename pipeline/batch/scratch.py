"""Temporary folders of a run, and the removal of those that killed runs left."""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.files.whole_file import NotWritten, remove_unless_held
from pipeline.problem import refused

PREFIX = "drupe-run-"


@contextmanager
def scratch(*, near: Path | None = None) -> Iterator[Path]:
    """A folder that exists inside the block, in the temporary folder or as a hidden one beside `near`.

    It is locked meanwhile; a call removes the folders of killed runs, which no process holds. Raises
    BatchRefused or NotWritten if it cannot create one.
    """
    try:
        place = Path(tempfile.gettempdir()) if near is None else near.parent
        place.mkdir(parents=True, exist_ok=True)
        prefix = PREFIX if near is None else f".{near.name}.{PREFIX}"
        _sweep(place, prefix)
        folder, lock = _made(place, prefix)
    except OSError as error:
        if near is None:
            sentence = (
                f"no temporary folder can be made ({error.strerror}); free space there, or set TMPDIR to a "
                "folder that can be written."
            )
            raise refused(str(error.filename or "the temporary folder"), sentence) from None
        if isinstance(error, FileExistsError | NotADirectoryError):
            raise refused(near.parent, "is or lies in a file, not a folder; choose another place.") from None
        raise NotWritten(near, error) from None
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _made(place: Path, prefix: str) -> tuple[Path, int]:
    """A new folder and its held lock; tries again if another run swept the folder before it was locked."""
    while True:
        folder = Path(tempfile.mkdtemp(dir=place, prefix=prefix))
        with suppress(FileNotFoundError):
            lock = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
            with suppress(OSError):  # without locks, `_sweep` removes nothing either
                fcntl.flock(lock, fcntl.LOCK_EX)
            if folder.exists():
                return folder, lock
            os.close(lock)


def _sweep(place: Path, prefix: str) -> None:
    """Removes folders of killed runs, by their name."""
    for folder in place.glob(f"{prefix}*"):
        remove_unless_held(folder, folder=True)


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
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Sets environment variables inside the block; processes started there inherit them."""
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        for name in values:
            os.environ.pop(name, None)
        os.environ.update({name: before[name] for name in values if name in before})


def moved_in(made: Path, target: Path) -> None:
    """Moves a folder to its place. An existing empty folder there stays the same one: a shell may be in it.
    batch.toml, which makes it a batch, comes last.
    """
    if not target.is_dir():
        made.rename(target)
        return
    for path in sorted(made.iterdir(), key=lambda path: path.name == "batch.toml"):
        path.rename(target / path.name)

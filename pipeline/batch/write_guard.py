"""Keeps drupe from writing over its inputs, and two runs from writing into one results folder.

drupe writes results only into a folder that is new, empty, or has its list of written files
(pipeline.files.manifest). The folder must not be inside a fruit's folder. Places are compared by device and
inode after links are followed, so that another spelling or a link makes no difference.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pipeline.batch.layout import BatchFolder
from pipeline.files.manifest import LIST_LOCK, in_the_way, is_claimed, not_ours_sentence, was_ours
from pipeline.files.plain_file import listed, not_plain
from pipeline.files.whole_file import MARK, lock_of
from pipeline.problem import BatchRefused, Problem, refused

LOCK = ".lock"
"""The file in a results folder that a run locks while it writes there."""


@contextmanager
def results_lock(root: Path, *, option: str = "--out") -> Iterator[None]:
    """Locks the results folder for this run; raises BatchRefused if another run holds it or it is unwritable.

    A file system without locks does not separate two runs.
    """
    with ExitStack() as stack:
        try:
            root.mkdir(parents=True, exist_ok=True)
            held = stack.enter_context(lock_of(root / LOCK, wait_s=0.0))
        except OSError as error:
            sentence = f"cannot be written ({error.strerror}); choose another place with {option}."
            raise refused(root, sentence) from None
        if not held:
            sentence = (
                f"another run is writing here and holds {LOCK}; wait for it, or choose another {option}."
            )
            raise refused(root, sentence)
        yield


def is_held(root: Path) -> bool:
    """Whether another run is writing into the results folder `root`."""
    if not (root / LOCK).is_file():
        return False
    try:
        with lock_of(root / LOCK, wait_s=0.0) as held:
            return not held
    except OSError:
        return False


def require_results_place(root: Path, batch: BatchFolder) -> None:
    """Raises BatchRefused if results of the batch must not go into the folder `root`."""
    if root == batch.default_results and root.is_symlink():
        raise refused(root, "is a link; name the place it leads to with --out.")
    fruits = [place for place in (root.absolute(), *_around(root)) if _holds_fruit(place)]
    require_made_by_drupe(root, "--out", outside=[batch.fruits, *fruits])


def require_made_by_drupe(root: Path, option: str, *, outside: Iterable[Path] = ()) -> None:
    """Raises BatchRefused if the folder is not empty and drupe did not make it. Raises it also for a file,
    and for a place inside a folder of inputs (`outside`).
    """
    _require_outside(root, outside, f"{_elsewhere(option)}.")
    if root.exists() and not root.is_dir():
        raise refused(root, f"is a file; {_elsewhere(option)}.")
    if is_claimed(root) or not root.is_dir():
        return
    names = (path.name for path in root.iterdir())
    if strange := sorted(name for name in names if name not in (LOCK, LIST_LOCK) and MARK not in name):
        sentence = (
            f"holds {listed(strange, 3)} and was not made by drupe, so it is no folder of results; "
            f"{_elsewhere(option)}, or move its files away."
        )
        raise refused(root, sentence)


def require_free(targets: Iterable[Path], option: str) -> None:
    """Raises BatchRefused with every file in the way of results: drupe did not write it, or somebody changed
    it since.
    """
    if obstacles := list(in_the_way(targets)):
        raise BatchRefused(_in_the_way(path, option) for path in obstacles)


def require_file_apart(
    target: Path, *, inputs: Iterable[Path], folders: Iterable[Path], but_in: Path | None = None
) -> None:
    """Raises BatchRefused if `target` is one of the inputs, or is inside one of the `folders` of inputs.

    `but_in`: a folder in one of them into which drupe may write.
    """
    if any(same_place(target, path) for path in inputs):
        raise refused(target, "is read by this command, and is not overwritten; give another name.")
    if but_in is None or not _lies_in(target, but_in):
        _require_outside(target, folders, "give another name.")


def require_new_or_ours(target: Path, is_ours: Callable[[Path], bool], what: str) -> None:
    """Raises BatchRefused if `target` is a folder, or a file that is not `what` according to `is_ours`."""
    if not target.name or target.is_dir():
        raise refused(target, "is a folder; give the name of a file.")
    if not target.exists() and not target.is_symlink():
        return
    if target.is_symlink() or not_plain(target) or not is_ours(target):
        raise refused(
            target, f"exists and is not {what}, so it is not overwritten; move it away or give another name."
        )


def _elsewhere(option: str) -> str:
    return f"choose another place with {option}"


def _require_outside(target: Path, folders: Iterable[Path], advice: str) -> None:
    for folder in folders:
        if _lies_in(target, folder):
            raise refused(target, f"lies in {folder}, which is read and never written into; {advice}")


def _in_the_way(path: Path, option: str) -> Problem:
    """The problem of a file that drupe would overwrite: a link, a changed file, or another program's."""
    if path.is_symlink():
        sentence = f"is a link, and is not written through; remove it, or {_elsewhere(option)}."
    elif was_ours(path):
        sentence = (
            "was changed since drupe wrote it (opening it in a spreadsheet and saving is enough), so it is "
            "not overwritten; rename it or move it away, which keeps your changes, and run the same command "
            f"again: it writes a new {path.name}. Or {_elsewhere(option)}."
        )
    else:
        sentence = not_ours_sentence(_elsewhere(option))
    return Problem(str(path), sentence)


def _holds_fruit(place: Path) -> bool:
    return place.name.lower() == "fruits" and BatchFolder(place.parent).settings.is_file()


def _around(path: Path) -> tuple[Path, ...]:
    """The resolved path and all folders around it; empty if links form a loop."""
    try:
        real = path.resolve()
    except (OSError, RuntimeError):
        return ()
    return real, *real.parents


def _lies_in(path: Path, folder: Path) -> bool:
    return any(same_place(place, folder) for place in _around(path))


def same_place(path: Path, other: Path) -> bool:
    """Whether both are one file or folder, even if neither exists yet."""
    try:
        return path.samefile(other)
    except OSError:
        return os.path.realpath(path) == os.path.realpath(other)

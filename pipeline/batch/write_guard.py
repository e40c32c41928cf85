"""Nothing is written onto, into or above what is read.

Places are compared by device and inode once links are followed, so that another spelling, a link, or a file
system that does not tell capitals apart makes no difference. Inside a batch, results may go into `results/`
or another folder that holds no inputs and is not in `fruits/`.
"""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from pipeline.batch.layout import PARTS, BatchFolder, CaseFolder, FruitResults, Results
from pipeline.files.manifest import is_ours, strange_list, was_ours
from pipeline.files.plain_file import not_plain
from pipeline.problem import BatchRefused, Problem, refused

Place = tuple[int, int]
MOVE = "choose another place"


def require_results_apart(results: Results, batch: BatchFolder, inputs: Iterable[Path], option: str) -> None:
    """Raises BatchRefused where `results` is the batch, holds inputs of it or of another, or lies in them."""
    root = results.root
    if root == batch.default_results and root.is_symlink():
        raise refused(root, f"is a link; name the place it leads to with {option}.")
    above = _places_above(inputs) | _lineage(batch.root)
    if (at := _place(root)) is not None and at in above:
        held = (
            "is the batch itself" if at == _place(batch.root) else "holds the batch, or a file that it reads"
        )
        raise refused(root, f"{held}; {MOVE} with {option} (without it: {batch.default_results}).")
    _require_outside(root, _trees(batch), f"{MOVE} with {option}.")
    for input_path in results.inputs_inside():
        name = input_path.relative_to(root)
        raise refused(root, f"holds {name}, so it is no folder of results; {MOVE} with {option}.")
    _require_outside(root, _fruit_of_others(root), f"{MOVE} with {option}.")


def require_temporary_apart(place: Path, batch: BatchFolder) -> None:
    """Raises BatchRefused where `place`, in which temporary files are made, is among the fruit: a folder of
    them in grasps/ looks like a grasp.
    """
    _require_outside(place, _trees(batch), "set TMPDIR to another folder.")


def require_free(
    results: Results, fruits: Iterable[FruitResults], option: str, *, tables: Iterable[Path] = ()
) -> None:
    """Raises BatchRefused with every file in the way of the results that drupe did not write. `tables`: those
    beside the ranking that are asked for.
    """
    fruit_results = list(fruits)
    folders = dict.fromkeys(folder for fruit in fruit_results for folder in (fruit.root.parent, fruit.root))
    obstacles = [path for path in folders if path.is_symlink()] or [
        *results.in_the_way(tables),
        *(path for fruit in fruit_results for path in fruit.in_the_way()),
    ]
    if obstacles:
        raise BatchRefused(_in_the_way(path, option) for path in dict.fromkeys(obstacles))


def require_targets_free(root: Path, targets: Iterable[Path], option: str) -> None:
    """The same of these files in the results folder `root` alone."""
    taken = [path for path in targets if (path.is_symlink() or path.exists()) and not is_ours(path)]
    if obstacles := [*strange_list(root), *taken]:
        raise BatchRefused(_in_the_way(path, option) for path in obstacles)


def require_work_apart(work: Path, case: CaseFolder, inputs: Iterable[Path]) -> None:
    """Raises BatchRefused where a case's meshes must not be kept in `work`."""
    at = _place(work)
    if at is not None and at in _places_above(inputs) | _lineage(case.root):
        raise refused(work, f"is the case, or holds what it reads; {MOVE} with --work.")
    _require_outside(work, [case.root], f"{MOVE} with --work.")
    for input_path in Results(work).inputs_inside():
        raise refused(
            work, f"holds {input_path.name}, so it is no folder to keep meshes in; {MOVE} with --work."
        )
    if taken := list(FruitResults(work).in_the_way()):
        raise BatchRefused(_in_the_way(path, "--work") for path in taken)


def require_file_apart(
    target: Path,
    *,
    inputs: Iterable[Path],
    folders: Iterable[Path],
    but_in: Path | None = None,
    advice: str = "give another name.",
) -> None:
    """Raises BatchRefused where `target` is one of the inputs, or lies in one of the folders read.

    `but_in`: a folder in one of them that may be written into.
    """
    at = _place(target)
    if at is not None and at in {_place(path) for path in inputs}:
        raise refused(target, f"is read by this command, and is not overwritten; {advice}")
    if but_in is None or _place(but_in) not in _lineage(target):
        _require_outside(target, folders, advice)


def require_new_or_ours(target: Path, is_ours: Callable[[Path], bool], what: str) -> None:
    """Raises BatchRefused where a file stands at `target` that is not `what`, as `is_ours` tells."""
    if not target.name or target.is_dir():
        raise refused(target, "is a folder; give the name of a file.")
    if not target.exists() and not target.is_symlink():
        return
    if target.is_symlink() or not_plain(target) or not is_ours(target):
        raise refused(
            target, f"exists and is not {what}, so it is not overwritten; move it away or give another name."
        )


def batch_trees(batch: BatchFolder) -> list[Path]:
    """The folders of a batch that only its user writes into: itself but for results, and its fruit."""
    return [batch.root, *map(Path, _trees(batch))]


def _trees(batch: BatchFolder) -> list[str]:
    """Names, since paths take four times as long: every newcomer of a watched batch asks about all fruit.

    Raises OSError where fruits/ is there and cannot be read.
    """
    fruits = batch.fruits
    fruit_folders: list[str] = []
    try:
        with os.scandir(fruits) as entries:
            fruit_folders = sorted(entry.path for entry in entries if _is_folder(entry))
    except (FileNotFoundError, NotADirectoryError):
        pass
    return [str(fruits), *fruit_folders, *(f"{path}/{part}" for path in fruit_folders for part in PARTS)]


def _is_folder(entry: os.DirEntry[str]) -> bool:
    """Whether a folder stands there, links followed. None does where that cannot be told, as of a link that
    leads to itself: nothing can be reached through it.
    """
    try:
        return entry.is_dir()
    except OSError:
        return False


def _fruit_of_others(target: Path) -> list[Path]:
    """Of the folders that `target` is or lies in: those that hold the fruit of some batch."""
    around = target.resolve()
    return [
        place
        for place in (around, *around.parents)
        if place.name.lower() == "fruits" and BatchFolder(place.parent).settings.is_file()
    ]


def _require_outside(target: Path, trees: Iterable[Path | str], advice: str) -> None:
    around = _lineage(target)
    for tree in trees:
        if _place(tree) in around:
            raise refused(target, f"lies in {tree}, which is read and never written into; {advice}")


def _in_the_way(path: Path, option: str) -> Problem:
    """The problem of a file that would be overwritten: a link, one changed since, or another's."""
    if path.is_symlink():
        return Problem(
            str(path), f"is a link, and is not written through; remove it, or {MOVE} with {option}."
        )
    if was_ours(path):
        sentence = (
            "was changed since drupe wrote it (opening it in a spreadsheet and saving is enough), so it is "
            "not overwritten; rename it or move it away, which keeps your changes, and run the same command "
            f"again: it writes a new {path.name}. Or {MOVE} with {option}."
        )
        return Problem(str(path), sentence)
    sentence = "was not written by drupe, or was changed since, so it is not overwritten; move it away, or"
    return Problem(str(path), f"{sentence} {MOVE} with {option}.")


def _place(path: Path | str) -> Place | None:
    try:
        status = os.stat(path)  # noqa: PTH116 - of a name without a Path
    except (OSError, RuntimeError):
        return None
    return status.st_dev, status.st_ino


def _lineage(path: Path) -> set[Place]:
    """`path`, if it is there, and every folder around it, links followed."""
    try:
        real = path.resolve()
    except (OSError, RuntimeError):
        return set()
    return {place for at in (real, *real.parents) if (place := _place(at)) is not None}


def _places_above(inputs: Iterable[Path]) -> set[Place]:
    folders = {folder for path in inputs for folder in (path.parent, _real(path).parent)}
    return {place for folder in folders for place in _lineage(folder)}


def _real(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path

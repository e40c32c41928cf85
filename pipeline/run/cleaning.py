"""`drupe clean`: removes what drupe wrote into a folder of results, and nothing else."""

from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

from pipeline.batch.layout import CACHE_FILE, FruitResults, Results
from pipeline.batch.results_lock import LOCK, results_lock
from pipeline.files.lock_file import is_lock_file
from pipeline.files.manifest import LIST_LOCK, MANIFEST, is_claimed, is_ours
from pipeline.files.whole_file import MARK
from pipeline.problem import refused


@dataclass(frozen=True, kw_only=True)
class Cleaned:
    """Files that were removed (or would be) and their bytes, and files that stayed because drupe did not
    write them or somebody has changed them.
    """

    removed: tuple[Path, ...]
    size_bytes: int
    left: tuple[Path, ...]


def clean(out: Path, *, everything: bool, dry: bool) -> Cleaned:
    """Removes the kept stages of every fruit, or `everything` that drupe wrote.

    No link is followed. Raises BatchRefused where `out` holds no results, or a run is writing there.
    """
    results = Results(out)
    if out.is_symlink() or not is_claimed(out):
        sentence = "is not a results folder of drupe grade; give the folder from --out."
        raise refused(out, sentence)
    with nullcontext() if dry else results_lock(out):
        fruits = [FruitResults(path) for path in _folders(out / "fruits")]
        stages = [path for fruit in fruits for path in _stages(fruit.cache)]
        whole = [path for fruit in fruits for path in fruit.files]
        of_batch = [*results.files, results.run, *results.tables_on_request]
        wanted = [*stages, *whole, *of_batch] if everything else stages
        there = [path for path in wanted if path.is_symlink() or path.exists()]
        kept = set(stages)
        ours = [path in kept or is_ours(path) for path in there]
        removed = list(compress(there, ours))
        left = [path for path, removable in zip(there, ours, strict=True) if not removable]
        size = sum(path.lstat().st_size for path in removed)
        if not dry:
            for path in removed:
                path.unlink(missing_ok=True)
            if everything and not left:
                _lists(results, fruits)
    return Cleaned(removed=tuple(removed), size_bytes=size, left=tuple(left))


def _folders(place: Path) -> list[Path]:
    if place.is_symlink() or not place.is_dir():
        return []
    return sorted(path for path in place.iterdir() if path.is_dir() and not path.is_symlink())


def _stages(cache: Path) -> Iterator[Path]:
    """What stages keep in a folder that drupe keeps for them, and unfinished files of killed runs."""
    if cache.is_symlink() or not is_claimed(cache):
        return
    for path in sorted(cache.iterdir()):
        plain = path.is_file() and not path.is_symlink() and path.name != MANIFEST
        if plain and (CACHE_FILE.fullmatch(path.name) or MARK in path.name):
            yield path


def _lists(results: Results, fruits: list[FruitResults]) -> None:
    """The lists of what was written go last, and folders that are empty then. While the lock of the results
    is held nobody else writes there, so it goes after all else.
    """
    for fruit in fruits:
        for folder in (fruit.cache, fruit.root):
            _emptied(folder, LIST_LOCK)
    _emptied(results.root / "fruits")
    _emptied(results.root, LIST_LOCK, LOCK)


def _emptied(folder: Path, *locks: str) -> None:
    """Removes a folder that holds nothing but its list and empty `locks`, in this order."""
    if not folder.is_dir() or folder.is_symlink():
        return
    left = {path.name for path in folder.iterdir()}
    if left <= {MANIFEST, *locks} and all(
        is_lock_file(folder / file_name) for file_name in left - {MANIFEST}
    ):
        for name in (MANIFEST, *locks):
            (folder / name).unlink(missing_ok=True)
        with suppress(OSError):  # a run that begins there now
            folder.rmdir()

"""`drupe clean`: removes what drupe wrote into a folder of results, and nothing else."""

from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from pipeline.batch.layout import CACHE_FILE, FruitResults
from pipeline.batch.results_lock import LOCK, results_lock
from pipeline.files.manifest import LIST_LOCK, MANIFEST, is_claimed, is_ours, listed_in
from pipeline.files.whole_file import MARK
from pipeline.problem import refused


@dataclass(frozen=True, kw_only=True)
class Cleaned:
    """Files that were removed (or would be) and their bytes, and files that stayed because somebody has
    changed them.
    """

    removed: tuple[Path, ...]
    size_bytes: int
    left: tuple[Path, ...]


def clean(out: Path, *, everything: bool, dry: bool) -> Cleaned:
    """Removes the kept stages of every fruit, or `everything` that drupe wrote.

    No link is followed. Raises BatchRefused where `out` holds no results, or a run is writing there.
    """
    if out.is_symlink() or not is_claimed(out):
        raise refused(out, "is not a results folder of drupe grade; give the folder from --out.")
    with nullcontext() if dry else results_lock(out):
        fruits = list(_folders(out / "fruits"))
        stages = [path for fruit in fruits for path in _stages(FruitResults(fruit).cache)]
        listed = [path for folder in (out, *fruits) for path in listed_in(folder)] if everything else []
        written = [path for path in listed if path.is_symlink() or path.exists()]
        left = tuple(path for path in written if not is_ours(path))
        removed = (*stages, *(path for path in written if path not in left))
        size = sum(path.lstat().st_size for path in removed)
        if not dry:
            for path in removed:
                path.unlink(missing_ok=True)
            if everything and not left:
                for fruit in fruits:
                    _emptied(FruitResults(fruit).cache)
                    _emptied(fruit, MANIFEST, LIST_LOCK)
                _emptied(out / "fruits")
                _emptied(out, MANIFEST, LIST_LOCK, LOCK)
    return Cleaned(removed=removed, size_bytes=size, left=left)


def _folders(place: Path) -> Iterator[Path]:
    if place.is_dir() and not place.is_symlink():
        yield from sorted(path for path in place.iterdir() if path.is_dir() and not path.is_symlink())


def _stages(cache: Path) -> Iterator[Path]:
    """What stages keep in a fruit's folder, and unfinished files of killed runs."""
    if cache.is_symlink() or not cache.is_dir() or not is_claimed(cache.parent):
        return
    for path in sorted(cache.iterdir()):
        plain = path.is_file() and not path.is_symlink()
        if plain and (CACHE_FILE.fullmatch(path.name) or MARK in path.name):
            yield path


def _emptied(folder: Path, *own_names: str) -> None:
    """Removes a folder that holds nothing but files of these names, in this order."""
    if not folder.is_dir() or folder.is_symlink() or {p.name for p in folder.iterdir()} - {*own_names}:
        return
    for name in own_names:
        (folder / name).unlink(missing_ok=True)
    with suppress(OSError):  # a run that begins there now
        folder.rmdir()

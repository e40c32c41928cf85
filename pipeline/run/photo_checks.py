"""The part of `drupe check` on a fruit's photos. It finds unreadable, blurred or badly exposed photos, those
that show too little of the mat, and sides that no photo shows.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from fem.fem_failure import FemFailure
from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import FruitFolder
from pipeline.batch.opening import Batch
from pipeline.batch.outcome import Outcome
from pipeline.problem import Problem
from recon.cameras.photos import FEWEST_PHOTOS, Photo, read_photo, require_enough
from recon.cameras.printed_mat import Mat
from recon.cameras.unused_photos import unused_photos
from recon.checks.photo_check import checked_photos
from recon.checks.view_check import view_doubts
from recon.recon_failure import ReconFailure
from tactile.readers.hdf5_file import first_line
from tactile.tactile_failure import TactileFailure


def tried(row: FruitRow, path: Path, read: Callable[[], Iterable[Problem] | None]) -> Iterator[Problem]:
    """Problems of the file at `path` that `read` returns or raises, so that later files are read too."""
    try:
        yield from read() or ()
    except (ReconFailure, TactileFailure, FemFailure) as failure:
        yield at(row, path, failure.detail)
    except MemoryError:
        yield at(row, path, "needs more memory than this machine has; expected a file of usual size.")
    except OSError as error:
        why = error.strerror or first_line(error)
        yield at(row, path, f"is not readable ({why}); ask for permission to read it, or copy it again.")
    except Exception as fault:  # noqa: BLE001 - a fault of ours costs this file alone, and is said as one
        said = f"{type(fault).__name__}: {first_line(fault)}"
        yield at(
            row,
            path,
            f"an internal error of drupe occurred while reading {path.name}: {said}; "
            "report it with the file.",
        )


def doubted(row: FruitRow, path: Path, sentence: str) -> Problem:
    """A problem that stops nothing, but puts the fruit's E in doubt."""
    return Problem(str(path), f"{sentence} E will be in doubt.", fruit_id=row.fruit_id, doubtful=True)


def at(row: FruitRow, path: Path, sentence: str) -> Problem:
    """A problem that stops the fruit, or one of its recordings."""
    return Problem(str(path), sentence, fruit_id=row.fruit_id)


LONGEST_SIDE_PX = 1000
"""Longest side to which photos are reduced here: 24 of them take 2 s of one core, at grading's 1600 px 5 s.
It still finds blur of 2 px in photos of 1280 px."""


def photo_problems(batch: Batch, row: FruitRow, folder: FruitFolder, *, quick: bool) -> Iterator[Problem]:
    """Problems of a fruit's photos and their scale. `quick`: only reads every photo."""
    if not row.has_height and not batch.folder.mat.exists() and not batch.without_scale:
        sentence = f'"{row.fruit_id}" has no height_mm, and mat.json is missing, so the photos have no scale.'
        yield at(row, batch.folder.table, sentence)
    quick = quick or (batch.mat is None and batch.folder.mat.exists())  # `survey` reports the mat's own fault
    look = partial(_set_problems, row, mat=batch.mat, quick=quick)
    if folder.photo_files():
        yield from look(folder.photos, folder.photo_files(), "The folder")
    else:
        yield from (_remark(row, folder.photos, sentence) for sentence in unused_photos(folder.photos))
        yield at(row, folder.root, Outcome.NO_SHAPE.sentence("The folder"))
    if folder.photos_flipped.is_dir():
        yield from look(
            folder.photos_flipped, folder.flipped_files(), "The folder of photos of the upside-down fruit"
        )


def _set_problems(
    row: FruitRow, place: Path, paths: Sequence[Path], where: str, *, mat: Mat | None, quick: bool
) -> Iterator[Problem]:
    """Problems of one folder of photos: their number, each photo, and all together."""
    yield from (_remark(row, place, sentence) for sentence in unused_photos(place))
    yield from tried(row, place, lambda: require_enough(len(paths), where=where))
    photos: list[Photo] = []

    def read(path: Path) -> None:
        photo = read_photo(path, longest_side_px=LONGEST_SIDE_PX)
        if not quick:
            photos.append(photo)

    for path in paths:
        yield from tried(row, path, partial(read, path))
    if len(photos) < FEWEST_PHOTOS:
        return
    remarks: list[str] = []
    yield from tried(row, place, lambda: _look(row, photos, mat, remarks))
    yield from (_remark(row, place, sentence) for sentence in remarks)


def _look(row: FruitRow, photos: Sequence[Photo], mat: Mat | None, remarks: list[str]) -> None:
    """Adds grading's remarks on light, focus and tags to `remarks`, and the sides that no photo shows.

    Raises ReconFailure if grading would refuse the set.
    """
    checked = checked_photos(photos, mat)
    remarks += checked.warnings
    if mat is not None:
        names = [photo.name for photo in photos]
        height_mm, left_out = row.height_mm, checked.warnings
        remarks += view_doubts(checked.photos, mat, given=names, height_mm=height_mm, left_out=left_out)


def _remark(row: FruitRow, place: Path, sentence: str) -> Problem:
    return Problem(str(place), f"{row.fruit_id}: {sentence}", fruit_id=row.fruit_id, remark=True)

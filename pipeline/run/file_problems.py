"""Problems of one file of a fruit: turns the errors of readers into sentences."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from fem.fem_failure import FemFailure
from pipeline.batch.fruits_table import FruitRow
from pipeline.problem import Problem
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

"""What the public functions raise: one exception, whose text says what was wrong and what to do."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fem.fem_failure import FemFailure
from pipeline.batch.outcome import FruitEnded
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused
from recon.recon_failure import ReconFailure
from tactile.tactile_failure import TactileFailure


class DrupeError(ValueError):
    """The input gives no result. The text says what was found, what was expected, and what to do."""


KNOWN = (BatchRefused, FemFailure, FruitEnded, NotWritten, ReconFailure, TactileFailure)


@contextmanager
def refusals(root: Path | None = None) -> Iterator[None]:
    """Turns every failure of drupe's packages into a DrupeError; paths are named from `root` on."""
    try:
        yield
    except KNOWN as failure:
        sentence = str(failure)
        raise DrupeError(sentence if root is None else sentence.replace(f"{root}/", "")) from failure
    except ExceptionGroup as failures:
        if failures.split(KNOWN)[1] is not None:  # a mistake of the program
            raise
        raise DrupeError(" ".join(str(failure) for failure in failures.exceptions)) from failures

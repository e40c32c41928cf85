"""The one exception of the public functions; its text states the fault and the remedy."""

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
    """The input gives no result. The text states the value found, the expected one, and the remedy."""


KNOWN = (BatchRefused, FemFailure, FruitEnded, NotWritten, ReconFailure, TactileFailure)


@contextmanager
def refusals(root: Path | None = None) -> Iterator[None]:
    """Converts failures of drupe's packages in the block to DrupeError; removes `root` from their paths."""
    try:
        yield
    except KNOWN as failure:
        sentence = str(failure)
        raise DrupeError(sentence if root is None else sentence.replace(f"{root}/", "")) from failure
    except ExceptionGroup as failures:
        if failures.split(KNOWN)[1] is not None:  # a fault of the program
            raise
        raise DrupeError(" ".join(str(failure) for failure in failures.exceptions)) from failures

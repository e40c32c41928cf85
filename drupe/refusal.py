"""What the public functions raise: one exception, whose text says what was wrong and what to do."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class DrupeError(ValueError):
    """The input gives no result. The text says what was found, what was expected, and what to do."""


@contextmanager
def refusals(root: Path | None = None) -> Iterator[None]:
    """Turns every failure of drupe's packages into a DrupeError; paths are named from `root` on."""
    from fem.fem_failure import FemFailure
    from pipeline.batch.outcome import FruitEnded
    from pipeline.diagnosis.explaining import NotExplained
    from pipeline.files.whole_file import NotWritten
    from pipeline.problem import BatchRefused
    from recon.recon_failure import ReconFailure
    from tactile.tactile_failure import TactileFailure

    known = (BatchRefused, FemFailure, FruitEnded, NotExplained, NotWritten, ReconFailure, TactileFailure)
    try:
        yield
    except known as failure:
        sentence = str(failure)
        raise DrupeError(sentence if root is None else sentence.replace(f"{root}/", "")) from failure
    except ExceptionGroup as failures:
        raise DrupeError(" ".join(str(failure) for failure in failures.exceptions)) from failures

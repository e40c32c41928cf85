"""One run at a time writes into a results folder."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pipeline.files.lock_file import lock_of
from pipeline.problem import refused

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

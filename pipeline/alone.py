"""One run at a time writes into a results folder."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager

from pipeline.layout import Results
from pipeline.problem import BatchRefused, Problem


@contextmanager
def alone(results: Results) -> Iterator[None]:
    """Holds the results folder for this run; the operating system lets go of it however the run ends."""
    try:
        results.root.mkdir(parents=True, exist_ok=True)
        file = results.lock.open("w")
    except OSError as error:
        raise BatchRefused(
            [
                Problem(
                    str(results.root),
                    f"cannot be written ({error.strerror}); choose another place with --out.",
                )
            ]
        ) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BatchRefused(
                [
                    Problem(
                        str(results.root),
                        "another run is writing here; wait for it, or choose another --out.",
                    )
                ]
            ) from None
        yield

"""What a refusal is: a ReconFailure of one problem, whose sentence has the words."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from recon.recon_failure import ReconFailure, ReconProblem


@contextmanager
def refused(problem: ReconProblem, words: str | None = None) -> Iterator[None]:
    """What runs inside is refused for this problem, with these words (a regular expression)."""
    with pytest.raises(ReconFailure, match=words) as caught:
        yield
    assert caught.value.problem is problem

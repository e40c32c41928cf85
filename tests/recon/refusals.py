"""What a refusal is: a failure of one problem, whose sentence has the words."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from fem.fem_failure import FemFailure, FemProblem
from recon.recon_failure import ReconFailure, ReconProblem
from tactile.tactile_failure import TactileFailure, TactileProblem

FAILURES = {FemProblem: FemFailure, ReconProblem: ReconFailure, TactileProblem: TactileFailure}


@contextmanager
def refused(
    problem: FemProblem | ReconProblem | TactileProblem, words: str | None = None
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """What runs inside is refused for this problem, with these words (a regular expression); the failure."""
    with pytest.raises(FAILURES[type(problem)], match=words) as caught:
        yield caught
    assert caught.value.problem is problem

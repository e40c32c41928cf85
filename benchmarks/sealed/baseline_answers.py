"""What the baselines say of a case's linear problem; none of them where scikit-learn is not installed."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from reduced_case import ReducedCase

from fem.mismatch.result import Modulus

sys.path.append(str(Path(__file__).resolve().parent / "baselines"))
BASELINES = ("modulus alone", "Gaussian process", "sparse regression", "random forest")
"""In the order of the tables. The last is trained when the proof is checked."""


def baselines_of(case: ReducedCase, *, E: Modulus) -> dict[str, Any]:
    """Answers by name, as plain JSON values."""
    from modulus_alone import modulus_alone

    found = {"modulus alone": modulus_alone(E)}
    if find_spec("sklearn") is None:
        return found
    from gaussian_process import gaussian_process
    from sparse_regression import sparse_regression

    found["Gaussian process"] = gaussian_process(case.samples, E)
    found["sparse regression"] = sparse_regression(case, E)
    return found

"""Solve with one sparse symmetric matrix many times: PARDISO if installed, else SuperLU on fem's order."""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_array, csr_array, triu
from scipy.sparse.linalg import splu

from fem.sparse.elimination_order import fill_reducing_order

Solve = Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]]


def factorise(matrix: csr_array) -> Solve:
    """The function b -> matrix^-1 b for a symmetric positive definite matrix; b holds one or more columns."""
    if importlib.util.find_spec("pypardiso") is not None:
        return _pardiso(matrix)
    return _superlu(matrix)


def _superlu(matrix: csr_array) -> Solve:
    """Solves with SciPy's SuperLU on a fill-reducing order."""
    pattern = csr_array(matrix)
    forward = fill_reducing_order(pattern)
    back = np.argsort(forward)
    permuted = csc_array(pattern[forward][:, forward])
    factors = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(b: np.ndarray) -> np.ndarray:
        return np.asarray(factors.solve(np.ascontiguousarray(b[forward]))[back])

    return solve


def _pardiso(matrix: csr_array) -> Solve:
    """Solves with MKL's Pardiso, where it is installed."""
    pypardiso: Any = importlib.import_module("pypardiso")
    upper = csr_array(triu(matrix, format="csr"))
    upper.sort_indices()
    solver = pypardiso.PyPardisoSolver(mtype=2)
    solver.factorize(upper)

    def solve(b: np.ndarray) -> np.ndarray:
        flat = np.asfortranarray(b.reshape(len(b), -1))
        return np.asarray(solver.solve(upper, flat)).reshape(b.shape)

    return solve

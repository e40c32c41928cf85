"""Solve with one sparse symmetric matrix many times: PARDISO if installed, else SuperLU on a METIS order."""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_array, csr_array, triu
from scipy.sparse.linalg import splu

Solve = Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]]


def factorise(matrix: csr_array) -> Solve:
    """The function b -> matrix^-1 b for a symmetric positive definite matrix; b holds one or more columns."""
    if importlib.util.find_spec("pypardiso") is not None:
        return _pardiso(matrix)
    return _superlu(matrix)


def _superlu(matrix: csr_array) -> Solve:
    """Solves with SciPy's SuperLU after a nested dissection."""
    pymetis: Any = importlib.import_module("pymetis")
    pattern = csr_array(matrix)
    rows = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
    off = rows != pattern.indices  # the ordering wants a graph without loops
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows[off], minlength=pattern.shape[0]))])
    graph = pymetis.CSRAdjacency(starts.astype(np.int64), pattern.indices[off].astype(np.int64))
    _, order = pymetis.nested_dissection(graph)
    back = np.asarray(order)
    forward = np.argsort(back)
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

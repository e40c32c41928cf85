"""The dense stiffness that a sparse one leaves on a few unknowns, taken from its factors.

With K = L U and the kept unknowns eliminated last, their Schur complement is L22 U22: the last blocks of the
factors multiplied (Golub and Van Loan 2013, section 3.2.11, without pivoting). That costs one factorisation
and no solve.
"""

import importlib
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu


def schur_complement(matrix: csr_array, kept: Int[np.ndarray, " d"]) -> Float[np.ndarray, "d d"]:
    """Stiffness on the unknowns `kept` of a symmetric positive definite matrix, the others left free."""
    count = matrix.shape[0]
    inner = np.ones(count, dtype=bool)
    inner[kept] = False
    inside = np.flatnonzero(inner)
    order = np.concatenate([inside[_dissected(csr_array(matrix[inside][:, inside]))], kept])
    permuted = csc_array(matrix[order][:, order])
    factors = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    first = len(inside)
    last = np.arange(first, count)
    if not (np.array_equal(factors.perm_c[first:], last) and np.array_equal(factors.perm_r[first:], last)):
        raise ArithmeticError("the factorisation moved the unknowns that were to be eliminated last")
    lower = csc_array(factors.L[:, first:])[first:].toarray()
    upper = csc_array(factors.U[:, first:])[first:].toarray()
    found = lower @ upper
    return np.asarray((found + found.T) / 2)


def _dissected(matrix: csr_array) -> Int[np.ndarray, " n"]:
    pymetis: Any = importlib.import_module("pymetis")
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    off = rows != matrix.indices  # the ordering wants a graph without loops
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows[off], minlength=matrix.shape[0]))])
    graph = pymetis.CSRAdjacency(starts.astype(np.int64), matrix.indices[off].astype(np.int64))
    _, back = pymetis.nested_dissection(graph)
    return np.asarray(np.argsort(np.asarray(back)))

"""The one border to sparse direct solvers: factorise once, solve for many right-hand sides.

Nothing else in the code knows which solver is behind it. Here: the multifrontal Cholesky factorisation of
fem.sparse.multifrontal on a fill-reducing order. See docs/decisions/0002.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array

from fem.fem_failure import FemFailure, FemProblem
from fem.sparse.elimination_order import ordering
from fem.sparse.fronts import Fronts, fronts
from fem.sparse.multifrontal import CholeskyFactor, NotPositiveDefinite, cholesky

Factor = CholeskyFactor
"""A factorised matrix."""


def solver_name() -> str:
    """The solver in use, for records."""
    return f"multifrontal Cholesky (drupe) on a {ordering()} order"


def factorise(stiffness: csr_array) -> Factor:
    """Factorise a symmetric positive definite matrix; raises SINGULAR_STIFFNESS where it is not one.

    Both triangles are stored.
    """
    stiffness = _canonical(stiffness)
    return _plan(stiffness).of(stiffness)


def analyse(stiffness: csr_array) -> "Analysis":
    """Plan the elimination for the pattern of a symmetric matrix; its values do not matter."""
    return _plan(_canonical(stiffness))


def _plan(stiffness: csr_array) -> "Analysis":
    """Of a canonical matrix."""
    if (np.diff(stiffness.indptr) == 0).any():
        raise _singular("a node belongs to no element")
    return Analysis(fronts(stiffness), stiffness.indptr, stiffness.indices)


@dataclass(frozen=True)
class Analysis:
    """What the pattern of nonzeros alone decides; good for all matrices that share it (Newton steps)."""

    fronts: Fronts
    indptr: Int[np.ndarray, " d1"]
    indices: Int[np.ndarray, " e"]

    def factorise(self, stiffness: csr_array) -> Factor:
        """Factorise a matrix of the analysed pattern; raises SINGULAR_STIFFNESS like `factorise`."""
        if not self._has(stiffness):
            stiffness = _canonical(stiffness)
        if not self._has(stiffness):
            raise ValueError("the matrix has other nonzeros than the one that was analysed; analyse it again")
        return self.of(stiffness)

    def of(self, stiffness: csr_array) -> Factor:
        """Of a canonical matrix of just this pattern."""
        try:
            factor = cholesky(self.fronts, stiffness.data)
        except NotPositiveDefinite as error:
            raise _singular("a pivot is not positive") from error
        probe = np.random.default_rng(0).standard_normal((stiffness.shape[0], 1))
        answer = factor.solve(probe)
        missed = float(np.abs(stiffness @ answer - probe).max())
        if not (missed < 1e-6 and float((probe * answer).sum()) > 0):
            raise _singular(f"the relative residual of a trial load is {missed:.1e}")
        return factor

    def _has(self, stiffness: csr_array) -> bool:
        """Whether the matrix stores the nonzeros that were analysed, in their order."""
        same = np.array_equal(stiffness.indptr, self.indptr)
        return same and np.array_equal(stiffness.indices, self.indices)


def _canonical(stiffness: csr_array) -> csr_array:
    """The same matrix with sorted columns, each once, and with every nonzero's mirror image.

    Products of sparse matrices leave out sums that vanish exactly, on one side of the diagonal perhaps and
    not on the other; the elimination counts on both.
    """
    if not stiffness.has_canonical_format:
        stiffness = stiffness.copy()
        stiffness.sum_duplicates()
    across = stiffness.tocsc()  # its columns are the rows of the mirror image
    same = np.array_equal(across.indptr, stiffness.indptr)
    if same and np.array_equal(across.indices, stiffness.indices):
        return stiffness
    # Imaginary ones hold a place for each nonzero's mirror image: sums that vanish would be left out again.
    mirror = csr_array((across.data + 1j, across.indices, across.indptr), shape=stiffness.shape)
    here = csr_array((stiffness.data + 1j, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
    whole = (here + mirror).tocsr()
    return csr_array((whole.data.real / 2, whole.indices, whole.indptr), shape=stiffness.shape)


def _singular(why: str) -> FemFailure:
    return FemFailure(
        FemProblem.SINGULAR_STIFFNESS,
        f"the stiffness matrix is not positive definite ({why}). Check for loose or inverted "
        "elements, or a base that does not support the fruit",
    )

"""The one border to sparse direct solvers: factorise once, solve for many right-hand sides.

Nothing else in the code knows which solver is behind it. Here: SuperLU on a METIS nested-dissection order,
without pivoting, as the matrices are symmetric positive definite.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import pymetis
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu

from fem.failure import FemFailure, FemProblem


@runtime_checkable
class Factor(Protocol):
    """A factorised matrix K."""

    def solve(self, load: Float[np.ndarray, "d f"]) -> Float[np.ndarray, "d f"]:
        """K^-1 load, column by column."""
        ...

    def last_compliance(self) -> Float[np.ndarray, "c c"]:
        """K^-1 on the dofs named as `last`, in their order: dense, symmetric; (0, 0) if none were named."""
        ...


@runtime_checkable
class Analysis(Protocol):
    """What the pattern of nonzeros alone decides; good for all matrices that share it (Newton steps)."""

    def factorise(self, stiffness: csr_array) -> Factor:
        """Factorise a matrix of the analysed pattern; raises SINGULAR_STIFFNESS like `factorise`."""
        ...


def solver_name() -> str:
    """The solver in use, for records."""
    return "SuperLU (scipy) on a METIS order"


def factorise(stiffness: csr_array, *, last: Int[np.ndarray, " c"] | None = None) -> Factor:
    """Factorise a symmetric positive definite matrix; raises SINGULAR_STIFFNESS where it is not one.

    `last`: the dofs among which `Factor.last_compliance` is wanted.
    """
    return analyse(stiffness, last=last).factorise(stiffness)


def analyse(stiffness: csr_array, *, last: Int[np.ndarray, " c"] | None = None) -> Analysis:
    """Order the elimination for the pattern of a symmetric matrix; its values do not matter."""
    if (np.diff(stiffness.indptr) == 0).any():
        raise _singular("a node belongs to no element")
    last = np.zeros(0, dtype=np.int64) if last is None else last
    return _Order(nested_dissection(stiffness), last)


@dataclass(frozen=True)
class _Order:
    order: Int[np.ndarray, " d"]
    last: Int[np.ndarray, " c"]

    def factorise(self, stiffness: csr_array) -> Factor:
        permuted = csc_array(stiffness[self.order][:, self.order])
        try:
            lu = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as error:
            raise _singular(str(error)) from error
        factor = _PermutedLU(lu, self.order, self.last)
        probe = np.random.default_rng(0).standard_normal((len(self.order), 1))
        answer = factor.solve(probe)
        missed = float(np.abs(stiffness @ answer - probe).max())
        if not (missed < 1e-6 and float((probe * answer).sum()) > 0):
            raise _singular(f"a trial load is missed by {missed:.1e} of itself")
        return factor


@dataclass(frozen=True)
class _PermutedLU:
    lu: SuperLU
    order: Int[np.ndarray, " d"]
    last: Int[np.ndarray, " c"]

    def solve(self, load: Float[np.ndarray, "d f"]) -> Float[np.ndarray, "d f"]:
        solution = np.empty(load.shape)
        for k in range(load.shape[1]):  # SuperLU takes two to five times as long for many columns at once
            solution[self.order, k] = self.lu.solve(load[self.order, k])
        return solution

    def last_compliance(self) -> Float[np.ndarray, "c c"]:
        compliance = np.empty((len(self.last), len(self.last)))
        for k, dof in enumerate(self.last):
            unit = np.zeros((len(self.order), 1))
            unit[dof] = 1
            compliance[:, k] = self.solve(unit)[self.last, 0]
        return (compliance + compliance.T) / 2


def nested_dissection(matrix: csr_array) -> Int[np.ndarray, " d"]:
    """A fill-reducing elimination order (METIS), found on groups of rows with one and the same pattern."""
    group, members = _same_pattern(matrix)
    rows = np.repeat(group, np.diff(matrix.indptr))
    n_groups = int(group.max()) + 1
    columns = group[matrix.indices]
    other = rows != columns
    if not other.any():
        return members
    links = (np.ones(other.sum()), (rows[other], columns[other]))
    graph = csr_array(coo_array(links, shape=(n_groups, n_groups)))
    ranked, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(graph.indptr, graph.indices))
    start = np.r_[0, np.cumsum(np.bincount(group))]
    return np.concatenate([members[start[g] : start[g + 1]] for g in ranked])


def _same_pattern(matrix: csr_array) -> tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]]:
    """The group of each row (rows of one group have equal columns), and all rows sorted by group."""
    weight = np.random.default_rng(1).integers(1, 2**62, size=matrix.shape[0], dtype=np.int64)
    mark = np.add.reduceat(weight[matrix.indices], matrix.indptr[:-1])  # wraps around: a hash
    _, group = np.unique(mark, return_inverse=True)
    return group, np.argsort(group, kind="stable")


def _singular(why: str) -> FemFailure:
    return FemFailure(
        FemProblem.SINGULAR_STIFFNESS,
        f"the stiffness matrix is not positive definite ({why}); look for loose or folded elements, "
        "or a base that does not hold the fruit",
    )

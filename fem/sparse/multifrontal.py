"""Multifrontal Cholesky factorisation K = L L' with dense fronts, and solves for many loads at once.

Each front is a small dense matrix: pivots to eliminate, and the rows that their elimination changes. It
starts with entries of K, adds what the children's eliminations left over, eliminates its pivots (LAPACK
dpotrf, BLAS dtrsm), and hands what is left of its rows (dsyrk) to its parent.
Source: Duff and Reid, "The multifrontal solution of indefinite sparse symmetric linear equations", ACM
Trans. Math. Softw. 9, 1983; Liu, "The multifrontal method for sparse matrix solution", SIAM Review 34, 1992.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

from fem.sparse.extend_add import Front, RelativeIndices
from fem.sparse.fronts import NO_ENTRIES, Fronts


@dataclass(frozen=True)
class CholeskyFactor:
    """L of the fronts' order: for each front the triangle of its pivots and the rows below."""

    fronts: Fronts
    triangle: list[Float[np.ndarray, "_ _"]]
    below: list[Float[np.ndarray, "_ _"]]

    def solve(self, load: Float[np.ndarray, "d f"]) -> Float[np.ndarray, "d f"]:
        """K^-1 load: all columns go through each front together."""
        x = self._forward(load)
        self._backward(x, range(len(self.below) - 1, -1, -1))
        solution = np.empty_like(x)
        solution[self.fronts.order] = x
        return np.asarray(solution)

    def solve_at(
        self, load: Float[np.ndarray, "d f"], dofs: Int[np.ndarray, " c"]
    ) -> Float[np.ndarray, "c f"]:
        """(K^-1 load)[dofs]: back substitution goes through the fronts above these dofs alone."""
        fronts = self.fronts
        at = fronts.position[dofs]
        wanted = np.zeros(len(fronts.parent) + 1, dtype=bool)  # the last stands for a root's parent, -1
        wanted[np.searchsorted(fronts.start, at, side="right") - 1] = True
        for s, parent in enumerate(fronts.parent):
            if wanted[s]:
                wanted[parent] = True
        x = self._forward(load)
        self._backward(x, np.flatnonzero(wanted[:-1])[::-1].tolist())
        return np.asarray(x[at])

    def compliance(self, dofs: Int[np.ndarray, " c"]) -> Float[np.ndarray, "c c"]:
        """K^-1 on these dofs, in their order: dense, symmetric, without solving for each of them.

        K^-1 = L^-T L^-1, so that its part among chosen dofs is Y' Y with L Y = S, the columns of S picking
        the dofs. A dof's column is zero outside the path from its front to the root of the tree, and dofs far
        apart share no more than the last few fronts: each front works on the columns of the dofs below it
        alone.
        """
        fronts = self.fronts
        at = fronts.position[dofs]
        by_position = np.argsort(at, kind="stable")
        chosen = at[by_position]
        first = np.searchsorted(chosen, fronts.first_below).tolist()
        pivots = np.searchsorted(chosen, fronts.start).tolist()
        total = np.zeros((len(dofs), len(dofs)))
        pending: list[list[tuple[int, np.ndarray]]] = [[] for _ in fronts.rows]
        for s, rows in enumerate(fronts.rows):
            low, high = first[s], pivots[s + 1]
            if low == high:
                continue
            p = fronts.start[s + 1] - fronts.start[s]
            y = np.zeros((p + len(rows), high - low))
            y[chosen[pivots[s] : high] - fronts.start[s], np.arange(pivots[s], high) - low] = 1
            for child, update in pending[s]:
                relative_indices = fronts.relative_indices[child]
                if relative_indices is not None:
                    begin = first[child] - low
                    for a, b, row in relative_indices.runs:
                        y[row : row + b - a, begin : begin + update.shape[1]] += update[a:b]
            pending[s].clear()
            solve_triangle(self.triangle[s], y[:p])
            total[low:high, low:high] += y[:p].T @ y[:p]
            if fronts.parent[s] >= 0:
                pending[fronts.parent[s]].append((s, y[p:] - self.below[s] @ y[:p]))
        back = np.argsort(by_position)
        return total[np.ix_(back, back)]

    def _forward(self, load: Float[np.ndarray, "d f"]) -> Float[np.ndarray, "d f"]:
        """L^-1 load, in the fronts' order."""
        x = np.ascontiguousarray(load[self.fronts.order], dtype=float)  # rows in one piece, solved in place
        start, rows = self.fronts.start, self.fronts.rows
        for s, (triangle, below) in enumerate(zip(self.triangle, self.below, strict=True)):
            pivots = x[start[s] : start[s + 1]]
            if not pivots.any():
                continue  # no load here nor below: a load on few nodes reaches the fronts above them alone
            solve_triangle(triangle, pivots)
            if len(rows[s]):
                x[rows[s]] -= below @ pivots
        return x

    def _backward(self, x: Float[np.ndarray, "d f"], fronts: Iterable[int]) -> None:
        """L^-T x in its own place, at the pivots of these fronts, parents first."""
        start, rows = self.fronts.start, self.fronts.rows
        for s in fronts:
            pivots = x[start[s] : start[s + 1]]
            if len(rows[s]):
                pivots -= self.below[s].T @ x[rows[s]]
            dtrsm(1.0, self.triangle[s], pivots.T, side=1, lower=1, overwrite_b=1)


def solve_triangle(triangle: Float[np.ndarray, "p p"], load: Float[np.ndarray, "p f"]) -> None:
    """Turn load into L^-1 load in its own place."""
    dtrsm(1.0, triangle, load.T, side=1, lower=1, trans_a=1, overwrite_b=1)


class NotPositiveDefinite(Exception):
    """A pivot is not positive."""


def cholesky(fronts: Fronts, values: Float[np.ndarray, " e"]) -> CholeskyFactor:
    """Factorise the matrix whose stored values are given; raises NotPositiveDefinite."""
    triangles, rows_below = [], []
    pending: list[list[tuple[np.ndarray, RelativeIndices]]] = [[] for _ in fronts.rows]
    entries = fronts.entries
    for s, rows in enumerate(fronts.rows):
        p, q = fronts.start[s + 1] - fronts.start[s], len(rows)
        panel = _zeros(p * (p + q))
        mine = slice(entries.bounds[s], entries.bounds[s + 1])
        panel[entries.target[mine]] = values[entries.source[mine]]
        triangle = panel[: p * p].reshape(p, p).T
        below = panel[p * p :].reshape(p, q).T
        schur = _zeros(q * q).reshape(q, q).T
        front = Front(triangle.T, below.T, schur.T)
        for update, relative_indices in pending[s]:
            front.add(update, relative_indices)
        pending[s].clear()
        if dpotrf(triangle, lower=1, clean=0, overwrite_a=1)[1]:
            raise NotPositiveDefinite
        triangles.append(triangle)
        rows_below.append(below)
        to_parent = fronts.relative_indices[s]
        if to_parent is not None:
            dtrsm(1.0, triangle, below, side=1, lower=1, trans_a=1, overwrite_b=1)
            dsyrk(-1.0, below, beta=1.0, c=schur, lower=1, overwrite_c=1)
            pending[fronts.parent[s]].append((schur.T, to_parent))
    # solves know no entries of the matrix: they are as large as a sixth of the factor
    return CholeskyFactor(replace(fronts, entries=NO_ENTRIES), triangles, rows_below)


def _zeros(size: int) -> Float[np.ndarray, " n"]:
    """Zeros on small pages: numpy asks for huge ones, which virtual machines are slow to give."""
    return np.frombuffer(bytearray(8 * size + 8))[:size]

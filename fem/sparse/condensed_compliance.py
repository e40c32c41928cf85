"""K^-1 among chosen dofs, from a Cholesky factor, without solving for each of them.

K^-1 = L^-T L^-1, so that its part among chosen dofs is Y' Y with L Y = S, the columns of S picking the dofs.
A dof's column is zero outside the path from its front to the root of the tree, and dofs far apart share no
more than the last few fronts: each front works on the columns of the dofs below it alone.
"""

import numpy as np
from jaxtyping import Float, Int

from fem.sparse.multifrontal import CholeskyFactor, solve_triangle


def compliance(factor: CholeskyFactor, dofs: Int[np.ndarray, " c"]) -> Float[np.ndarray, "c c"]:
    """(K^-1)[dofs][:, dofs], dense and symmetric, in the order given."""
    fronts = factor.fronts
    at = fronts.position[dofs]
    by_position = np.argsort(at, kind="stable")
    chosen = at[by_position]
    first = np.searchsorted(chosen, fronts.first_below).tolist()
    own = np.searchsorted(chosen, fronts.start).tolist()
    total = np.zeros((len(dofs), len(dofs)))
    pending: list[list[tuple[int, np.ndarray]]] = [[] for _ in fronts.rows]
    for s, rows in enumerate(fronts.rows):
        low, high = first[s], own[s + 1]
        if low == high:
            continue
        p = fronts.start[s + 1] - fronts.start[s]
        y = np.zeros((p + len(rows), high - low))
        y[chosen[own[s] : high] - fronts.start[s], np.arange(own[s], high) - low] = 1
        for child, update in pending[s]:
            relative_indices = fronts.relative_indices[child]
            if relative_indices is not None:
                begin = first[child] - low
                for a, b, row in relative_indices.runs:
                    y[row : row + b - a, begin : begin + update.shape[1]] += update[a:b]
        pending[s].clear()
        solve_triangle(factor.triangle[s], y[:p])
        total[low:high, low:high] += y[:p].T @ y[:p]
        if fronts.parent[s] >= 0:
            pending[fronts.parent[s]].append((s, y[p:] - factor.below[s] @ y[:p]))
    back = np.empty_like(by_position)
    back[by_position] = np.arange(len(back))
    return total[np.ix_(back, back)]

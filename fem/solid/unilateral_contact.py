"""Contact that only pushes:  p >= 0,  w = G p + q >= 0,  p w = 0,  with G symmetric and positive definite.

The primal-dual active set: contact is closed where p > 0 or w < 0. There w = 0, elsewhere p = 0, until
nothing changes (Hintermueller, Ito, Kunisch 2002, "The primal-dual active set strategy as a semismooth Newton
method", SIAM Journal on Optimization 13). If the active set cycles, the problem is solved as least squares
with p >= 0 (Lawson and Hanson 1974), which cannot cycle.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import nnls

MOST_CHANGES = 40
"""Changes of the active set before it counts as cycling. Set by hand."""


def pressures(
    compliance: Float[np.ndarray, "c c"], opening: Float[np.ndarray, "f c"]
) -> Float[np.ndarray, "f c"]:
    """p for each of f openings q; each starts from the active set of the one before.

    Springs of 1 mm/N: a negative opening presses, a gap does not pull.

    >>> pressures(np.eye(2), np.array([[-1.0, 1.0]]))
    array([[1., 0.]])
    """
    pressure = np.zeros_like(opening)
    closed = np.zeros(len(compliance), dtype=bool)
    for frame, gap in enumerate(opening):
        pressure[frame], closed = _one(compliance, gap, closed)
    return pressure


def _one(
    compliance: Float[np.ndarray, "c c"], opening: Float[np.ndarray, " c"], closed: Bool[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, " c"], Bool[np.ndarray, " c"]]:
    """Pressures of one problem, and which points are closed; by non-negative least squares if need be."""
    for _ in range(MOST_CHANGES):
        pressure = np.zeros(len(opening))
        at = np.flatnonzero(closed)
        if len(at):
            pressure[at] = -cho_solve(cho_factor(compliance[np.ix_(at, at)]), opening[at])
        apart = compliance[:, at] @ pressure[at] + opening
        after = np.where(closed, pressure > 0, apart < 0)
        if (after == closed).all():
            return pressure, closed
        closed = after
    lower = cholesky(compliance, lower=True)
    pressure = nnls(lower.T, -solve_triangular(lower, opening, lower=True))[0]
    return pressure, pressure > 0

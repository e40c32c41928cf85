"""Products of shape function gradients over T10 elements: exact and cheap where edges are straight."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.elements.shape_functions import TET_EDGES, t10_gradient, tet_quadrature

#: mid-edge nodes no farther off, in edge lengths, count as halfway
STRAIGHT = 1e-14


def gradient_products(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]
) -> Iterator[tuple[int, int, Float[np.ndarray, "m 10 10"]]]:
    """i, j and H[., a, b] = integral of dN_a/dx_i dN_b/dx_j over each element, for all i <= j in turn.

    Straight elements have one Jacobian J, so that H is the same few integrals over the reference element
    times det J, J^-1 and J^-1; curved ones are integrated with 14 points. H is overwritten at the next turn.
    """
    x = nodes_mm[tets]
    straight = _is_straight(x)
    points, weights = tet_quadrature()
    reference = t10_gradient(points)
    integrals = np.einsum("q,qka,qlb->klab", weights, reference, reference).reshape(9, 100)
    inverse, det = inverse_3x3((x[straight, 1:4] - x[straight, :1]).transpose(1, 2, 0))
    slope, measure = slopes_and_volumes(x[~straight], reference)
    weighted = slope * (measure * weights)[..., None, None]
    h = np.empty((len(x), 10, 10))
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        factor = det * inverse[i][:, None] * inverse[j]
        h[straight] = (factor.reshape(9, -1).T @ integrals).reshape(-1, 10, 10)
        h[~straight] = weighted[:, :, i].swapaxes(1, 2) @ slope[:, :, j]
        yield i, j, h


def _is_straight(x: Float[np.ndarray, "m 10 3"]) -> Bool[np.ndarray, " m"]:
    """Whether all mid-edge nodes lie halfway."""
    a, b = x[:, TET_EDGES[:, 0]], x[:, TET_EDGES[:, 1]]
    off = np.abs(x[:, 4:] - (a + b) / 2).max(axis=(1, 2))
    return np.asarray(
        off <= STRAIGHT * np.maximum(np.abs(a - b).max(axis=(1, 2)), np.abs(a).max(axis=(1, 2)))
    )


def slopes_and_volumes(
    x: Float[np.ndarray, "m 10 3"], reference: Float[np.ndarray, "q 3 10"]
) -> tuple[Float[np.ndarray, "m q 3 10"], Float[np.ndarray, "m q"]]:
    """dN/dx and det(dx/dxi) at some points of elements with these nodes, from the derivatives to xi there."""
    jacobian = (reference.reshape(-1, 10) @ x).reshape(len(x), len(reference), 3, 3)
    inverse, det = inverse_3x3(jacobian.transpose(2, 3, 0, 1))
    return inverse.transpose(2, 3, 0, 1) @ reference, det


def inverse_3x3(
    matrix: Float[np.ndarray, "3 3 *m"],
) -> tuple[Float[np.ndarray, "3 3 *m"], Float[np.ndarray, "*m"]]:
    """Inverses and determinants of many small matrices, by cofactors."""
    inverse = np.empty(matrix.shape)
    for i in range(3):
        for k in range(3):
            a, b, c, d = (k + 1) % 3, (k + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, k] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    det = matrix[0, 0] * inverse[0, 0] + matrix[0, 1] * inverse[1, 0] + matrix[0, 2] * inverse[2, 0]
    inverse /= det
    return inverse, np.asarray(det)

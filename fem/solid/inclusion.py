"""A ball of softer flesh in the fruit: its share of the stiffness, and the amount of its first-order field.

With K1 the stiffness (for E = 1 MPa) of the flesh inside the ball, and a modulus there of `ratio` times the
one outside, K = K0 - (1 - ratio) K1.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from fem.elements.assembly import scattered, unit_lame_constants
from fem.elements.gradients import slopes_and_volumes
from fem.elements.shape_functions import TET_EDGES, t10_gradient, t10_shape
from fem.mesh.flesh_mesh import FleshMesh

RIM_MM = 0.6
"""Length across the ball's surface over which it fades out, so that its stiffness changes smoothly."""
HALVINGS = 2
"""Times that all edges are halved; elements are sampled at the middles of the parts."""
EIGHTHS = np.array(
    [
        [0, 4, 6, 7],
        [4, 1, 5, 8],
        [6, 5, 2, 9],
        [7, 8, 9, 3],
        [4, 9, 5, 6],
        [4, 9, 6, 7],
        [4, 9, 7, 8],
        [4, 9, 8, 5],
    ]
)
"""Nodes of a T10 that bound the eight tetrahedra, of equal volume, into which its edges' middles split it."""


def fading(distance_mm: Float[np.ndarray, "*b"], radius_mm: float) -> Float[np.ndarray, "*b"]:
    """One inside the ball, zero outside, a straight ramp of RIM_MM between."""
    return np.asarray(np.clip(0.5 + (radius_mm - distance_mm) / RIM_MM, 0.0, 1.0))


def ball_stiffness(
    mesh: FleshMesh, *, centre_mm: Float[np.ndarray, "3"], radius_mm: float, poisson_ratio: float
) -> csr_array:
    """K1 (3 n, 3 n), N/mm for E = 1 MPa, of the flesh inside a ball; empty where it holds no flesh."""
    corners = mesh.nodes_mm[mesh.tets[:, :4]]
    middle = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    near = np.linalg.norm(middle - centre_mm, axis=1) < radius_mm + RIM_MM + 1.2 * reach
    tets = mesh.tets[near]
    x = mesh.nodes_mm[tets]
    points, shape, gradient = _samples()
    weight = fading(np.linalg.norm(shape @ x - centre_mm, axis=2), radius_mm)
    inside = weight.any(axis=1)
    tets, x, weight = tets[inside], x[inside], weight[inside]
    slope, det = slopes_and_volumes(x, gradient)
    flat = slope.transpose(0, 1, 3, 2).reshape(len(x), len(points), 30)
    weighted = flat * (weight * det / (6 * len(points)))[..., None]
    products = (flat.transpose(0, 2, 1) @ weighted).reshape(-1, 10, 3, 10, 3)
    mu, lame = unit_lame_constants(poisson_ratio)
    stiffness = lame * products + mu * products.transpose(0, 1, 4, 3, 2)
    trace = mu * np.einsum("makbk->mab", products)
    for axis in range(3):
        stiffness[:, :, axis, :, axis] += trace
    return scattered(stiffness.reshape(-1, 30, 30), tets, len(mesh.nodes_mm))


def drop_of(ratio: float, poisson_ratio: float) -> float:
    """The amount x of the first-order field K0^-1 K1 U for a ball of this ratio.

    Inside a soft ball the flesh strains more. In an unbounded body under a constant strain

        x = (1 - ratio) / (1 - beta (1 - ratio)),      beta = 2 (4 - 5 nu) / (15 (1 - nu))

    for strains that change shape, not volume, as in flesh. Source: Eshelby, "The determination of the
    elastic field of an ellipsoidal inclusion, and related problems", Proceedings of the Royal Society A 241,
    1957.
    """
    beta = 2 * (4 - 5 * poisson_ratio) / (15 * (1 - poisson_ratio))
    return (1 - ratio) / (1 - beta * (1 - ratio))


@cache
def _samples() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles of the equal parts of the reference tetrahedron, with values and slopes of the shapes there."""
    corner = np.vstack([np.zeros(3), np.eye(3)])[None]
    for _ in range(HALVINGS):
        with_middles = np.concatenate([corner, corner[:, TET_EDGES].mean(axis=2)], axis=1)
        corner = with_middles[:, EIGHTHS].reshape(-1, 4, 3)
    reference = corner.mean(axis=1)
    return reference, t10_shape(reference), t10_gradient(reference)

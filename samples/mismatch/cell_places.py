"""Where the integration points of the bricks are: in the fruit, and how deep between skin and pit."""

import numpy as np
from jaxtyping import Float

from samples.hexahedra import Bricks, lagrange

_AT, _ = np.polynomial.legendre.leggauss(3)
"""Three Gauss points along each side of a brick: exact to degree 5."""


def _shares() -> Float[np.ndarray, "27 27"]:
    value, _ = lagrange(_AT)
    return np.asarray(np.einsum("ai,bj,ck->abcijk", value, value, value).reshape(27, 27))


def integration_points_mm(bricks: Bricks) -> Float[np.ndarray, "m 27 3"]:
    """Places of the 27 integration points of every cell, in the order of samples.brick_flesh."""
    return np.asarray(np.einsum("gn,mni->mgi", _shares(), bricks.nodes_mm[bricks.cells]))


def relative_depths(bricks: Bricks) -> Float[np.ndarray, "m 27"]:
    """Depth of every integration point: 0 at the skin, 1 at the pit, even along each ray."""
    return np.asarray(np.einsum("gn,mn->mg", _shares(), bricks.relative_depth[bricks.cells]))

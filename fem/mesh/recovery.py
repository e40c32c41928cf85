"""Smoother fields than finite elements give: superconvergent patch recovery on T10 meshes.

At every corner node a quadratic polynomial is fitted by least squares to a field known at four points of each
element around. Corners with fewer than `FULL_PATCH` elements, those of the boundary, borrow the elements next
to these. A mid-edge node takes the mean of its two corners' polynomials.
Source: Zienkiewicz and Zhu, "The superconvergent patch recovery and a posteriori error estimates",
International Journal for Numerical Methods in Engineering 33, 1992.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from fem.elements.shape_functions import TET_EDGES, t10_shape
from fem.mesh.flesh_mesh import FleshMesh

#: corner nodes with fewer elements around them borrow their neighbours'
FULL_PATCH = 16
#: barycentric coordinates of the four points, exact to degree 2
FOUR = np.full((4, 4), 0.1381966011250105) + 0.4472135954999579 * np.eye(4)
_I, _J = np.triu_indices(3)
"""Of a product of two coordinates, each pair once."""
#: weights on a patch's linear and quadratic terms against blow-up where its points nearly lie in a plane;
#: half on mixed products, so that the sum is the same in every frame
_RIDGE = 1e-3 * np.array([0, *3 * [0.1], *np.where(_I == _J, 1.0, 0.5)])


def recovered(mesh: FleshMesh, field: Float[np.ndarray, "m 4 c"]) -> Float[np.ndarray, "n c"]:
    """Nodal values of the smoothed field, of c components known at the `FOUR` points of every element."""
    corners, of_tet = np.unique(mesh.tets[:, :4], return_inverse=True)
    centre = mesh.nodes_mm[corners]
    place = t10_shape(FOUR[:, 1:]) @ mesh.nodes_mm[mesh.tets]
    patches = _patches(of_tet.reshape(-1, 4), len(corners))
    count = np.diff(patches.indptr)
    polynomial = np.empty((len(corners), 10, field.shape[2]))
    size = np.empty(len(corners))
    for elements in np.unique(count):
        patch = np.flatnonzero(count == elements)
        tet = patches.indices[patches.indptr[patch][:, None] + np.arange(elements)]
        arm = place[tet] - centre[patch][:, None, None]
        size[patch] = np.linalg.norm(arm.mean(axis=2), axis=2).max(axis=1)
        terms = _terms(arm.reshape(len(patch), -1, 3) / size[patch][:, None, None])
        gram = terms.swapaxes(1, 2) @ terms
        gram += gram[:, :1, :1] * np.diag(_RIDGE)
        wanted = terms.swapaxes(1, 2) @ field[tet].reshape(len(patch), 4 * elements, -1)
        polynomial[patch] = np.linalg.solve(gram, wanted)
    values = np.empty((len(mesh.nodes_mm), polynomial.shape[2]))
    values[corners] = polynomial[:, 0]
    middles, first = np.unique(mesh.tets[:, 4:], return_index=True)
    ends = of_tet.reshape(-1, 4)[first // 6][np.arange(len(first))[:, None], TET_EDGES[first % 6]]
    arm = (mesh.nodes_mm[middles][:, None] - centre[ends]) / size[ends][..., None]
    values[middles] = (_terms(arm).reshape(-1, 1, 20) @ polynomial[ends].reshape(len(ends), 20, -1))[:, 0] / 2
    return values


def _patches(of_tet: Int[np.ndarray, "m 4"], n_corners: int) -> csr_array:
    """The elements of each corner's patch: the columns of its row."""
    tets = np.repeat(np.arange(len(of_tet)), 4)
    around = csr_array((np.ones(len(tets)), (of_tet.ravel(), tets)), shape=(n_corners, len(of_tet)))
    small = np.flatnonzero(np.diff(around.indptr) < FULL_PATCH)
    chosen = csr_array((np.ones(len(small)), (small, small)), shape=2 * (n_corners,))
    return csr_array(around + chosen @ (around @ around.T) @ around)


def _terms(x: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 10"]:
    """1, the coordinates, and their products."""
    return np.concatenate([np.ones((*x.shape[:-1], 1)), x, x[..., _I] * x[..., _J]], axis=-1)

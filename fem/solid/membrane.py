"""A thin elastic skin on the flesh: what it costs to stretch it, as forces on its nodes.

Plane stress in the tangent plane, N = Et / (1 - nu^2) [(1 - nu) e + nu tr(e) I], e the tangential part of the
skin's strain; bending costs nothing.
"""

import numpy as np
from scipy.sparse import csr_array

from fem.elements.shape_functions import t6_gradient, tri_quadrature
from fem.mesh.flesh_mesh import FleshMesh


def membrane_stiffness(mesh: FleshMesh, *, poisson_ratio: float) -> csr_array:
    """Stiffness (3 n, 3 n) of a skin of Et = 1 N/mm on all outer faces; symmetric, N/mm."""
    points, weights = tri_quadrature()
    x = mesh.nodes_mm[mesh.outer_faces]
    reference = t6_gradient(points)
    tangent = np.einsum("qia,max->mqix", reference, x)
    metric = np.einsum("mqix,mqjx->mqij", tangent, tangent)
    area = np.sqrt(np.linalg.det(metric)) * weights
    slope = np.einsum("mqij,mqjx,qia->mqax", np.linalg.inv(metric), tangent, reference, optimize=True)
    along = np.einsum("mqij,mqix,mqjy->mqxy", np.linalg.inv(metric), tangent, tangent, optimize=True)
    shear = 0.5 / (1 + poisson_ratio)
    bulk = poisson_ratio / (1 - poisson_ratio**2)
    # e : e' of tangential strains: (slope . slope') P + slope' (x) slope, halved
    near = np.einsum("mqax,mqbx->mqab", slope, slope)
    blocks = np.einsum("mq,mqab,mqxy->maxby", shear * area, near, along, optimize=True)
    blocks += np.einsum("mq,mqay,mqbx->maxby", shear * area, slope, slope, optimize=True)
    blocks += np.einsum("mq,mqax,mqby->maxby", bulk * area, slope, slope, optimize=True)
    dofs = (3 * mesh.outer_faces[:, :, None] + np.arange(3)).reshape(len(x), 18)
    row, column = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
    size = 3 * len(mesh.nodes_mm)
    return csr_array((blocks.reshape(-1), (row, column)), shape=(size, size))

"""A thin elastic skin on the flesh: its stiffness against stretch, and its nodal forces.

Plane stress in the tangent plane, N = Et / (1 - nu^2) [(1 - nu) e + nu tr(e) I], e the tangential part of the
skin's strain; bending stiffness is zero.
"""

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from fem.elements.assembly import scattered
from fem.elements.shape_functions import t6_gradient, tri_quadrature
from fem.mesh.flesh_mesh import FleshMesh


def membrane_stiffness(mesh: FleshMesh, *, poisson_ratio: float) -> csr_array:
    """Stiffness (3 n, 3 n) of a skin of Et = 1 N/mm on all outer faces; symmetric, N/mm."""
    reference, tangent, metric, area = _at_rest(mesh)
    inverse = np.linalg.inv(metric)
    slope = np.einsum("mqij,mqjx,qia->mqax", inverse, tangent, reference, optimize=True)
    along = np.einsum("mqij,mqix,mqjy->mqxy", inverse, tangent, tangent, optimize=True)
    shear = 0.5 / (1 + poisson_ratio)
    bulk = poisson_ratio / (1 - poisson_ratio**2)
    # e : e' of tangential strains: (slope . slope') P + slope' (x) slope, halved
    near = np.einsum("mqax,mqbx->mqab", slope, slope)
    blocks = np.einsum("mq,mqab,mqxy->maxby", shear * area, near, along, optimize=True)
    blocks += np.einsum("mq,mqay,mqbx->maxby", shear * area, slope, slope, optimize=True)
    blocks += np.einsum("mq,mqax,mqby->maxby", bulk * area, slope, slope, optimize=True)
    return scattered(blocks.reshape(-1, 18, 18), mesh.outer_faces, len(mesh.nodes_mm))


def membrane_forces(
    mesh: FleshMesh, displacement: Float[np.ndarray, "f n 3"], *, poisson_ratio: float
) -> Float[np.ndarray, "f n 3"]:
    """Nodal forces of the same skin at finite strain, N for Et = 1 N/mm.

    With the tangents a_i and A_i of the skin with and without displacement, the strain in the plane is
    E_ij = (a_i . a_j - A_i . A_j) / 2, and its stress N is as above (Saint Venant-Kirchhoff).
    """
    reference, at_rest, metric, area = _at_rest(mesh)
    inverse, faces = np.linalg.inv(metric), mesh.outer_faces
    shear, bulk = 1 / (1 + poisson_ratio), poisson_ratio / (1 - poisson_ratio**2)
    node_forces = np.zeros_like(displacement)
    for field, force in zip(displacement, node_forces, strict=True):
        moved = at_rest + np.einsum("qia,max->mqix", reference, field[faces])
        strain = (np.einsum("mqix,mqjx->mqij", moved, moved) - metric) / 2
        raised = inverse @ strain @ inverse
        trace = np.einsum("mqij,mqij->mq", inverse, strain)
        stress = shear * raised + (bulk * trace)[..., None, None] * inverse
        flux = np.einsum("mq,mqij,mqjx->mqix", area, stress, moved)
        by_face = np.einsum("mqix,qia->max", flux, reference)
        np.add.at(force, faces, by_face)
    return node_forces


def _at_rest(
    mesh: FleshMesh,
) -> tuple[
    Float[np.ndarray, "q 2 6"],
    Float[np.ndarray, "m q 2 3"],
    Float[np.ndarray, "m q 2 2"],
    Float[np.ndarray, "m q"],
]:
    """dN/dxi of the faces' shape functions, tangents A_i, A_i . A_j, and area of the quadrature points."""
    points, weights = tri_quadrature()
    reference = t6_gradient(points)
    tangent = np.einsum("qia,max->mqix", reference, mesh.nodes_mm[mesh.outer_faces])
    metric = np.einsum("mqix,mqjx->mqij", tangent, tangent)
    return reference, tangent, metric, np.sqrt(np.linalg.det(metric)) * weights

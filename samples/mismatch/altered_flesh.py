"""Altered flesh: varying modulus, extra stiffness along the stem, a skin.

Ratios of the modulus are given at the integration points. Stiffnesses are additions to that of plain flesh,
on the same unknowns (free nodes and the rigid pit), N/mm.
"""

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from samples.brick_flesh import BrickFlesh, assembled, rigid_tie, scattered
from samples.hexahedra import Bricks, lagrange

SPOT_EDGE_MM = 0.5
"""Width of a soft spot's edge, mm: half of an element under the pads, so that no mesh cuts the edge."""


def graded(bricks: Bricks, *, gamma: float) -> Float[np.ndarray, "m 27"]:
    """Ratio of the modulus 1 + gamma (2 d - 1) at relative depth d: 0 at the skin, 1 at the pit."""
    return 1 + gamma * (2 * relative_depths(bricks) - 1)


def soft_spot(
    bricks: Bricks, *, centre_mm: Float[np.ndarray, " 3"], radius_mm: float, ratio: float
) -> Float[np.ndarray, "m 27"]:
    """Ratio 1 - (1 - ratio) / (1 + exp((r - radius) / 0.5 mm)) at the distance r from the centre."""
    away = np.linalg.norm(integration_points_mm(bricks) - centre_mm, axis=-1)
    return np.asarray(1 - (1 - ratio) / (1 + np.exp(np.minimum((away - radius_mm) / SPOT_EDGE_MM, 50.0))))


def uneven(flesh: BrickFlesh, ratio: Float[np.ndarray, "m 27"]) -> csr_array:
    """Added stiffness if E is multiplied by `ratio` at every integration point."""
    bricks = flesh.bricks
    extra = assembled(
        bricks.cells, flesh.slopes, flesh.volumes * (ratio - 1), flesh.mu_MPa, flesh.lam_MPa,
        len(bricks.nodes_mm),
    )  # fmt: skip
    return _tied(flesh, extra)


def stiffer_along_stem(flesh: BrickFlesh, *, axial: float) -> csr_array:
    """Added stiffness for C_zzzz + axial mu, z the stem's axis: energy density axial mu eps_zz^2 / 2."""
    bricks = flesh.bricks
    along = flesh.slopes[..., 2]
    block = np.einsum("mga,mgb,mg->mab", along, along, flesh.volumes) * axial * flesh.mu_MPa
    return _tied(flesh, scattered(block, 3 * bricks.cells + 2, 3 * len(bricks.nodes_mm)))


def with_skin(flesh: BrickFlesh, *, Et_N_per_mm: float, poisson_ratio: float) -> csr_array:
    """Added stiffness of a membrane on the outer surface in plane stress; Et is Young's modulus x thickness.

    Membrane strain is the symmetric surface gradient of the displacement in the tangent plane. The law is
    that of a flat membrane, `D = Et / (1 - nu^2) [[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]]`.
    """
    bricks = flesh.bricks
    cells = bricks.skin_cells.reshape(-1, 9)
    at, weight = np.polynomial.legendre.leggauss(3)
    value, slope = lagrange(at)
    first = np.einsum("ai,bj->abij", slope, value).reshape(9, 9)
    second = np.einsum("ai,bj->abij", value, slope).reshape(9, 9)
    local = np.stack([first, second], axis=-1)
    tangents = np.einsum("gnk,mni->mgki", local, bricks.nodes_mm[cells])
    metric = np.einsum("mgki,mgli->mgkl", tangents, tangents)
    area = np.sqrt(np.linalg.det(metric)) * np.einsum("a,b->ab", weight, weight).ravel()
    gradient = np.einsum("gnk,mgkl,mgli->mgni", local, np.linalg.inv(metric), tangents)
    e1 = tangents[..., 0, :] / np.linalg.norm(tangents[..., 0, :], axis=-1, keepdims=True)
    normal = np.cross(tangents[..., 0, :], tangents[..., 1, :])
    e2 = np.cross(normal / np.linalg.norm(normal, axis=-1, keepdims=True), e1)
    d1, d2 = (np.einsum("mgni,mgi->mgn", gradient, e) for e in (e1, e2))
    strain = np.stack(
        [
            np.einsum("mgn,mgi->mgni", d1, e1),
            np.einsum("mgn,mgi->mgni", d2, e2),
            np.einsum("mgn,mgi->mgni", d2, e1) + np.einsum("mgn,mgi->mgni", d1, e2),
        ],
        axis=2,
    ).reshape(len(cells), 9, 3, 27)
    nu = poisson_ratio
    law = Et_N_per_mm / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
    block = np.einsum("mgax,ab,mgby,mg->mxy", strain, law, strain, area, optimize=True)
    dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(-1, 27)
    return _tied(flesh, scattered(block, dofs, 3 * len(bricks.nodes_mm)))


def _tied(flesh: BrickFlesh, full: csr_array) -> csr_array:
    tie = rigid_tie(flesh.bricks, flesh.free_nodes, flesh.pit_centre_mm)
    return csr_array(tie.T @ full @ tie)


def _shares() -> Float[np.ndarray, "27 27"]:
    """Shape functions of a brick's nodes at its 27 Gauss points."""
    at, _ = np.polynomial.legendre.leggauss(3)
    value, _ = lagrange(at)
    return np.asarray(np.einsum("ai,bj,ck->abcijk", value, value, value).reshape(27, 27))


def integration_points_mm(bricks: Bricks) -> Float[np.ndarray, "m 27 3"]:
    """Positions of the 27 integration points of every cell, in the order of samples.brick_flesh."""
    return np.asarray(np.einsum("gn,mni->mgi", _shares(), bricks.nodes_mm[bricks.cells]))


def relative_depths(bricks: Bricks) -> Float[np.ndarray, "m 27"]:
    """Relative depth of every integration point: 0 at the skin, 1 at the pit, linear along each ray."""
    return np.asarray(np.einsum("gn,mn->mg", _shares(), bricks.relative_depth[bricks.cells]))

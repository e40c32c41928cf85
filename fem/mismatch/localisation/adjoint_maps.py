"""Maps on the fruit's skin: which change of the flesh below each place would explain a fit's residual.

All from the basis functions' adjoint fields (fem.mismatch.model.adjoint_basis), the flesh below a place being
a ball of BALL_MM whose middle lies BELOW_MM under the skin; y are the whitened projections of the residual,
of unit variance in noise.

modulus score       -(d.y) / |d|, d of that ball: negative where softer flesh would explain y; where that
                    takes more than all of the modulus, what all of it explains
                    (fem.mismatch.localisation.spot_search)
eigenstrain score   six components of a strain that nothing presses on, growing with the load: with
                    g = sum over the ball of D eps(Lambda), chi2 = (g y)'(g g')^-1 (g y) of six degrees of
                    freedom, brought to a standard score (Wilson and Hilferty 1931, "The distribution of
                    chi-square", PNAS 17)
law error           density of the error in the constitutive relation of the least correction of the
                    displacement field that y asks for, lambda = sum_k y_k Lambda_k: root of
                    eps(lambda) : D : eps(lambda) over its mean in noise (Ladeveze and Chouaki 1999,
                    "Application of a posteriori error estimation for structural model updating", Inverse
                    Problems 15); 1 in noise
visible             signal over noise of a ball with 0.4 of the modulus

Markers and frames correlate (fem.mismatch.model.marker_equations): DESIGN_EFFECT of them count as one.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.localisation.spot_search import bounded_score
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, MARKER_VARIANCE_INFLATION
from fem.mismatch.result import FruitMap
from fem.solid.inclusion import drop_of, fading
from fem.solid.strain_field import COLUMN, COUNT, ROW, FleshStrain, elastic_stress

BALL_MM, BELOW_MM = 6.0, 4.0
"""Radius of the ball and depth of its middle, mm: as those searched for (RADII_MM of spot_search), just below
the skin. Set by hand."""
STANDARD_RATIO = 0.4
"""Of the moduli: the ball whose visibility is mapped, as the middle of those injected
(samples.mismatch.effect_levels)."""
SIX = 6
"""Components of a symmetric strain."""


def fruit_map(forward: ForwardModel, numbers: Float[np.ndarray, " k"]) -> FruitMap:
    """All four maps at the skin's corner nodes; `numbers`: AdjointBasis.observed of a fit's residual."""
    mesh, points, basis = forward.base.mesh, forward.points, forward.adjoint_basis
    vertices, triangles = skin_triangles(mesh)
    inward = -_normals(vertices, triangles)
    volume = points.volume_mm3.sum(axis=1)
    middle = points.point_mm.mean(axis=1)
    within = _within(vertices + BELOW_MM * inward, middle)
    cells = basis.cells.reshape(len(volume), 4, -1).sum(axis=1)
    drop = basis.without_modulus(within @ cells)
    stress, density, expected = _adjoint_fields(forward, numbers)
    by_volume = csr_array(within * volume)
    pushed = (by_volume @ stress.reshape(len(volume), -1)).reshape(len(vertices), SIX, -1)
    pushed = basis.without_modulus(pushed * COUNT[:, None])
    thinned = np.sqrt(DESIGN_EFFECT * MARKER_VARIANCE_INFLATION)
    law = (by_volume @ density) / np.maximum(by_volume @ expected, np.finfo(float).tiny)
    return FruitMap(
        vertices_mm=vertices,
        triangles=triangles,
        modulus_score=-bounded_score(drop, numbers)[0] / thinned,
        eigenstrain_score=_standard(pushed, numbers / thinned),
        law_error=np.sqrt(law),
        visible=np.linalg.norm(drop, axis=1) * drop_of(STANDARD_RATIO, forward.poisson_ratio) / thinned,
    )


def skin_triangles(mesh: FleshMesh) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """The skin's corner nodes, and its faces between them."""
    corners, faces = np.unique(mesh.outer_faces[:, :3], return_inverse=True)
    return mesh.nodes_mm[corners], faces.reshape(-1, 3)


def _normals(
    vertices: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    normal = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(axis, 3), minlength=len(vertices)) for axis in across.T],
        axis=1,
    )
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _within(centres: Float[np.ndarray, "v 3"], middle: Float[np.ndarray, "m 3"]) -> csr_array:
    """How much each element counts to the ball about each centre."""
    near = cKDTree(centres).sparse_distance_matrix(cKDTree(middle), BALL_MM + 0.5, output_type="coo_matrix")
    weight = fading(near.data, BALL_MM)
    shape = (len(centres), len(middle))
    return csr_array(coo_array((weight, (near.row, near.col)), shape=shape).tocsr())


def _adjoint_fields(
    forward: ForwardModel, numbers: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "m 6 k"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Of every element: D eps(Lambda_k); the density of lambda's law error; its mean in noise."""
    slope = _mean_slope(forward.points)
    elements = len(forward.points.volume_mm3)
    stresses, density, expected, first = [], np.zeros(elements), np.zeros(elements), 0
    for basis in forward.adjoint_basis.grasps:
        count = len(basis.moved)
        grasp_numbers = numbers[first : first + count]
        first += count
        nodal = np.moveaxis(basis.moved, 0, 2).reshape(forward.points.n_nodes, -1)
        gradient = (slope @ nodal).reshape(elements, 3, 3, count)
        strain = (gradient[:, ROW, COLUMN] + gradient[:, COLUMN, ROW]) / 2
        stress = elastic_stress(np.moveaxis(strain, 1, 2), poisson_ratio=forward.poisson_ratio)
        stress = np.ascontiguousarray(np.moveaxis(stress, 2, 1))
        expected += np.einsum("msk,msk,s->m", strain, stress, COUNT, optimize=True)
        density += np.einsum(
            "ms,ms,s->m", strain @ grasp_numbers, stress @ grasp_numbers, COUNT, optimize=True
        )
        stresses.append(stress)
    return np.concatenate(stresses, axis=2), density, expected


def _mean_slope(points: FleshStrain) -> csr_array:
    """Nodal values to the mean gradient of every element: (3 m, n)."""
    share = points.volume_mm3 / points.volume_mm3.sum(axis=1, keepdims=True)
    slope = np.einsum("mp,mpxa->mxa", share, points.slope)
    columns = np.repeat(points.mesh.tets, 3, axis=0)
    start = np.arange(0, columns.size + 1, 10)
    return csr_array((slope.ravel(), columns.ravel(), start), shape=(3 * len(slope), points.n_nodes))


def _standard(
    pushed: Float[np.ndarray, "v 6 k"], numbers: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " v"]:
    """The standard score of what six strains explain together."""
    recording = pushed @ numbers
    gram = pushed @ pushed.transpose(0, 2, 1)
    floor = 1e-10 * np.trace(gram, axis1=1, axis2=2) + np.finfo(float).tiny
    gram[:, np.arange(SIX), np.arange(SIX)] += floor[:, None]
    chi2 = np.einsum("vi,vi->v", recording, np.linalg.solve(gram, recording[..., None])[..., 0])
    spread = 2 / (9 * SIX)
    return np.asarray((np.cbrt(chi2 / SIX) - (1 - spread)) / np.sqrt(spread))

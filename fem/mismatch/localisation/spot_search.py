"""Places where a ball of softer flesh best explains a fit's residual: in the flesh, and under the skin.

y: whitened projections of the residual; d: those of a ball per unit drop of its modulus (sum over the points
inside, fem.mismatch.model.adjoint_basis). The best drop is d.y / d.d and its standard score d.y / |d|: the
adjoint score over the root of its Fisher information. Without that root, all spots would appear to be at the
surface. A modulus cannot be negative: the drop is at most MOST_DROP, scored by what this drop explains.

Markers and frames are correlated (fem.mismatch.model.marker_equations): on the map DESIGN_EFFECT of them
count as one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.marker_equations import DESIGN_EFFECT, MARKER_VARIANCE_INFLATION
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.result import FruitMap
from fem.solid.inclusion import drop_of, fading

GRID_MM = 3.0
"""Spacing of the places tried first: half a RADIUS_MM, so that no spot between two is missed."""
RADIUS_MM = 5.5
"""Radius of the ball tried everywhere: the middle of RADII_MM."""
RADII_MM = (4.0, 5.5, 7.5)
"""Radii tried at the best place; those injected are 4.5 to 8.5 (samples.mismatch.injected)."""
CONE_DEG = 38.0
"""A soft spot at a larger angle from the axes of all patches is not observable."""
APART_MM = 5.0
"""Candidates are at least this far from each other."""
OTHERS = 3
"""Number of further places with a signature; each costs a refit. Set by hand."""
MOST_DROP = 1.6
"""Drop of a ball without stiffness (fem.solid.inclusion.drop_of)."""
MAP_RADIUS_MM, BELOW_MM = 6.0, 4.0
"""Radius of the map's ball and depth of its middle under the skin, mm. Set by hand."""
STANDARD_RATIO = 0.4
"""Ratio of moduli of the ball whose visibility is mapped: the middle of those injected
(samples.mismatch.injected)."""


@dataclass(frozen=True, kw_only=True)
class Spot:
    """One place: its standard score and best drop; a drop of 1 is all of the modulus to first order."""

    centre_mm: Float[np.ndarray, "3"]
    radius_mm: float
    score: float
    drop: float


def best_spots(
    model: CaseModel,
    numbers: Float[np.ndarray, " k"],
    *,
    radii_mm: Sequence[float],
    others: int,
) -> tuple[Spot, ...]:
    """The best ball of softer flesh for each radius, then the best at up to `others` other places.

    Depth and radius are interchangeable to first order, hence the several radii at one place. `numbers`: as
    from AdjointBasis.observed.
    """
    centres = candidate_centres(model)
    balls_seen = model.adjoint_basis.without_modulus(
        balls(model, centres, RADIUS_MM) @ model.adjoint_basis.cells
    )
    score, _ = bounded_score(balls_seen, numbers)
    best = centres[int(score.argmax())]
    spots = [polished(model, numbers, best, radius_mm=radius) for radius in radii_mm]
    places = [best]
    for number in np.argsort(-score):
        if len(places) > others or score[number] <= 0:
            break
        if min(np.linalg.norm(centres[number] - place) for place in places) > APART_MM:
            places.append(centres[number])
            spots.append(polished(model, numbers, centres[number], radius_mm=RADIUS_MM))
    return tuple(spot for spot in spots if spot.score > 0)


def candidate_centres(model: CaseModel) -> Float[np.ndarray, "c 3"]:
    """A grid of places in the flesh within CONE_DEG of a patch's axis from the fruit's middle."""
    points = model.points.point_mm.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    axes = [np.arange(a, b, GRID_MM) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[cKDTree(points).query(grid)[0] < GRID_MM / 2]
    middle = (low + high) / 2
    way = (grid - middle) / np.maximum(np.linalg.norm(grid - middle, axis=1, keepdims=True), 1e-9)
    patches = np.vstack([patch_centres(recording) for recording in model.grasps]) - middle
    patches /= np.linalg.norm(patches, axis=1, keepdims=True)
    return np.asarray(grid[(way @ patches.T).max(axis=1) > np.cos(np.deg2rad(CONE_DEG))])


def patch_centres(recording: GraspResponse) -> Float[np.ndarray, "p 3"]:
    """Centroid of each pad's load on the fruit."""
    load = np.linalg.norm(recording.force_N, axis=2).sum(axis=0)
    weights = [load * (recording.pad_of_marker == pad) for pad in range(len(recording.links))]
    return np.stack([weight @ recording.tracks.place_mm / weight.sum() for weight in weights])


def balls(model: CaseModel, centres: Float[np.ndarray, "c 3"], radius_mm: float) -> csr_array:
    """Weight of each of the flesh's points in each ball: (c, points)."""
    points = model.points.point_mm.reshape(-1, 3)
    near = cKDTree(centres).sparse_distance_matrix(cKDTree(points), radius_mm + 0.5, output_type="coo_matrix")
    weight = fading(near.data, radius_mm)
    return csr_array(coo_array((weight, (near.row, near.col)), shape=(len(centres), len(points))).tocsr())


def polished(
    model: CaseModel,
    numbers: Float[np.ndarray, " k"],
    centre_mm: Float[np.ndarray, "3"],
    *,
    radius_mm: float,
) -> Spot:
    """The ball of this radius that explains most among those within APART_MM / 2 of this place."""
    points = model.points.point_mm.reshape(-1, 3)
    near = np.linalg.norm(points - centre_mm, axis=1) < radius_mm + 1.5 * APART_MM
    points, cells = points[near], model.adjoint_basis.without_modulus(model.adjoint_basis.cells[near])

    def observed_at(place: Float[np.ndarray, "3"]) -> Float[np.ndarray, " k"]:
        return np.asarray(fading(np.linalg.norm(points - place, axis=1), radius_mm) @ cells)

    def lost(place: Float[np.ndarray, "3"]) -> float:
        shown = observed_at(place)
        away = max(0.0, float(np.linalg.norm(place - centre_mm)) - APART_MM / 2)
        return -float(bounded_score(shown, numbers)[0]) * float(np.exp(-away))

    corners = centre_mm + np.vstack([np.zeros(3), 1.5 * np.eye(3)])
    centre_of_ball = minimize(
        lost,
        centre_mm,
        method="Nelder-Mead",
        options={"initial_simplex": corners, "maxfev": 80, "xatol": 0.05, "fatol": 0.01},
    ).x
    shown = observed_at(centre_of_ball)
    score, drop = bounded_score(shown, numbers)
    return Spot(centre_mm=centre_of_ball, radius_mm=radius_mm, score=float(score), drop=float(drop))


def bounded_score(
    shown: Float[np.ndarray, "*b k"], numbers: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "*b"], Float[np.ndarray, "*b"]]:
    """Signed root of the chi-square that the best drop within +-MOST_DROP explains, and that drop."""
    match = shown @ numbers
    size = np.maximum((shown**2).sum(axis=-1), np.finfo(float).tiny)
    drop = np.clip(match / size, -MOST_DROP, MOST_DROP)
    gain = np.maximum(2 * drop * match - drop**2 * size, 0.0)
    return np.asarray(np.sign(drop) * np.sqrt(gain)), np.asarray(drop)


def fruit_map(model: CaseModel, numbers: Float[np.ndarray, " k"]) -> FruitMap:
    """Scores of a ball under each of the skin's corner nodes; `numbers`: as from AdjointBasis.observed."""
    vertices, triangles = _skin_triangles(model.mesh)
    basis, below = model.adjoint_basis, vertices - BELOW_MM * _normals(vertices, triangles)
    shown = basis.without_modulus(balls(model, below, MAP_RADIUS_MM) @ basis.cells)
    thinned = np.sqrt(DESIGN_EFFECT * MARKER_VARIANCE_INFLATION)
    drop = drop_of(STANDARD_RATIO, model.poisson_ratio)
    return FruitMap(
        vertices_mm=vertices,
        triangles=triangles,
        modulus_score=-bounded_score(shown, numbers)[0] / thinned,
        visible=drop * np.linalg.norm(shown, axis=1) / thinned,
    )


def _skin_triangles(mesh: FleshMesh) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """The skin's corner nodes, and its triangles between them."""
    corners, faces = np.unique(mesh.outer_faces[:, :3], return_inverse=True)
    return mesh.nodes_mm[corners], faces.reshape(-1, 3)


def _normals(
    vertices: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """Outward unit normals of the vertices, weighted by area."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    normal = np.zeros_like(vertices)
    for corner in triangles.T:
        np.add.at(normal, corner, np.cross(b - a, c - a))
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

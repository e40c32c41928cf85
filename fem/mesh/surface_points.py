"""Points on the skin of a mesh: where they sit in its T6 faces, and how fields are read off there."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from fem.elements.shape_functions import t6_gradient, t6_shape, tri_quadrature
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.flesh_mesh import QUARTERS, FleshMesh

_T6_NODES = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])
"""Reference coordinates of a T6's nodes, in their order."""
GAUSS_NEWTON_STEPS = 6
"""Steps at most from a place in a face's middle or better; faces are nearly flat, the error is squared by
each."""
BORDER = 1e-12
"""Reference coordinates nearer than this to a face's edge lie on it: round-off of a clamped place."""


@dataclass(frozen=True)
class SurfacePoints:
    """p points on the curved skin: their face, coordinates in it, place, normal, gap to what was asked."""

    n_nodes: int
    face_nodes: Int[np.ndarray, "p 6"]
    reference: Float[np.ndarray, "p 2"]
    point_mm: Float[np.ndarray, "p 3"]
    normal: Float[np.ndarray, "p 3"]
    distance_mm: Float[np.ndarray, " p"]

    @classmethod
    def at(
        cls, mesh: FleshMesh, face_nodes: Int[np.ndarray, "p 6"], reference: Float[np.ndarray, "p 2"]
    ) -> "SurfacePoints":
        """Points of the skin itself, by their places in its faces."""
        place, normal, _ = _place_and_normal(reference, mesh.nodes_mm[face_nodes])
        return cls(len(mesh.nodes_mm), face_nodes, reference, place, normal, np.zeros(len(place)))

    @cached_property
    def interpolation(self) -> csr_array:
        """Sparse (p, n): nodal values of a field on the mesh to values at the points; rows sum to one."""
        shape = t6_shape(self.reference)
        row = np.repeat(np.arange(len(shape)), 6)
        entries = (shape.ravel(), (row, self.face_nodes.ravel()))
        return coo_array(entries, shape=(len(shape), self.n_nodes)).tocsr()

    def slid(self, mesh: FleshMesh, way_mm: Float[np.ndarray, "3"]) -> "SurfacePoints":
        """The points moved a little along the skin, on their own faces continued; distances are not kept."""
        x = mesh.nodes_mm[self.face_nodes]
        tangent = np.einsum("pin,pnx->pix", t6_gradient(self.reference), x)
        step = _least_squares_step(tangent, tangent @ way_mm)
        return SurfacePoints.at(mesh, self.face_nodes, self.reference + step)

    def among(self, nodes: Int[np.ndarray, " c"]) -> "SurfacePoints":
        """The same points on a field that is known at these nodes only (sorted; every face's are there)."""
        return replace(self, n_nodes=len(nodes), face_nodes=np.searchsorted(nodes, self.face_nodes))

    def sample(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f p 3"]:
        """A nodal vector field (or f of them) at the points."""
        nodal = np.moveaxis(field, 1, 0).reshape(self.n_nodes, -1)
        values = (self.interpolation @ nodal).reshape(len(self.reference), len(field), 3)
        return np.moveaxis(values, 0, 1)

    def point_load(self, force_N: Float[np.ndarray, "f p 3"]) -> Float[np.ndarray, "f n 3"]:
        """Forces at the points as forces on the nodes of their faces; total force and moment are kept."""
        at_points = np.moveaxis(force_N, 1, 0).reshape(len(self.reference), -1)
        nodal = (self.interpolation.T @ at_points).reshape(self.n_nodes, len(force_N), 3)
        return np.ascontiguousarray(np.moveaxis(nodal, 0, 1))


def locate(
    mesh: FleshMesh, points_mm: Float[np.ndarray, "p 3"], *, within_mm: float | None = None
) -> SurfacePoints:
    """The points of the skin closest to the given ones.

    Found on the faces cut in four flat triangles, then moved to the curved face by Gauss-Newton steps; of a
    point that ends on a face's border, the faces that share a corner with it are tried too.
    Raises OFF_SURFACE where a point is not finite or farther than within_mm.
    """
    if not np.isfinite(points_mm).all():
        raise FemFailure(
            FemProblem.OFF_SURFACE, "a contact point has a non-finite coordinate; check pose and markers"
        )
    near = mesh.skin_search.closest(points_mm)
    face_nodes = mesh.outer_faces[near.face // 4]
    reference = np.einsum("pk,pkd->pd", near.barycentric, _T6_NODES[QUARTERS[near.face % 4]])
    reference, distance = _closest_on_faces(points_mm, mesh.nodes_mm[face_nodes], reference)
    on_border = np.flatnonzero((reference.min(axis=1) <= 0) | (reference.sum(axis=1) >= 1 - BORDER))
    if len(on_border):
        owner, tried = _faces_around(mesh.outer_faces, near.face[on_border] // 4)
        owner = on_border[owner]
        others = mesh.outer_faces[tried]
        start = np.full((len(owner), 2), 1 / 3)
        there, reach = _closest_on_faces(points_mm[owner], mesh.nodes_mm[others], start)
        for pair in np.lexsort((tried, reach, owner)):
            if reach[pair] < distance[owner[pair]]:
                at = owner[pair]
                face_nodes[at], reference[at], distance[at] = others[pair], there[pair], reach[pair]
    if within_mm is not None and len(distance) and distance.max() > within_mm:
        worst = int(distance.argmax())
        where = ", ".join(f"{x:.1f}" for x in points_mm[worst])
        raise FemFailure(
            FemProblem.OFF_SURFACE,
            f"{(distance > within_mm).sum()} of {len(distance)} contact points are more than "
            f"{within_mm:g} mm from the skin (the worst at ({where}) mm, by {distance[worst]:.2f} "
            "mm). Check the pad's pose in the fruit frame",
        )
    return replace(SurfacePoints.at(mesh, face_nodes, reference), distance_mm=distance)


def skin_quadrature(mesh: FleshMesh) -> tuple[SurfacePoints, Float[np.ndarray, " p"]]:
    """Integration points of the whole skin and the area (mm2) that each stands for, exact to degree 5.

    A traction t at the points (MPa) is the load `points.point_load(t * area[:, None])`.
    """
    points, weights = tri_quadrature()
    face_nodes = np.repeat(mesh.outer_faces, len(points), axis=0)
    reference = np.tile(points, (len(mesh.outer_faces), 1))
    place, normal, stretch = _place_and_normal(reference, mesh.nodes_mm[face_nodes])
    on_skin = SurfacePoints(len(mesh.nodes_mm), face_nodes, reference, place, normal, np.zeros(len(place)))
    return on_skin, stretch * np.tile(weights, len(mesh.outer_faces))


def spread_out(
    points_mm: Float[np.ndarray, "p 3"], *, apart_mm: float = 0.0, most: int | None = None
) -> Int[np.ndarray, " k"]:
    """Numbers of points spread evenly: from the first on always the one farthest from those chosen, until all
    are within `apart_mm` of one of them or there are as many as wanted.
    """
    chosen = [0]
    away = np.linalg.norm(points_mm - points_mm[0], axis=1)
    while away.max() > apart_mm and len(chosen) < (most or len(points_mm)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(points_mm - points_mm[chosen[-1]], axis=1))
    return np.array(chosen)


def _place_and_normal(
    reference: Float[np.ndarray, "p 2"], x: Float[np.ndarray, "p 6 3"]
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Where the points of T6 faces lie, the unit normals there, and area per reference area."""
    place = np.einsum("pn,pnx->px", t6_shape(reference), x)
    tangent = np.einsum("pin,pnx->pix", t6_gradient(reference), x)
    normal = np.cross(tangent[:, 0], tangent[:, 1])
    stretch = np.linalg.norm(normal, axis=1)
    return place, normal / stretch[:, None], stretch


def _closest_on_faces(
    points_mm: Float[np.ndarray, "p 3"], x: Float[np.ndarray, "p 6 3"], reference: Float[np.ndarray, "p 2"]
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, " p"]]:
    """Where each point falls on its own curved face, from a first place in it, and how far off (mm)."""
    for _ in range(GAUSS_NEWTON_STEPS):
        tangent = np.einsum("pin,pnx->pix", t6_gradient(reference), x)
        gap = points_mm - np.einsum("pn,pnx->px", t6_shape(reference), x)
        before, step = reference, _least_squares_step(tangent, np.einsum("pix,px->pi", tangent, gap))
        reference = _into_triangle(reference + step)
        if np.abs(reference - before).max() < BORDER:
            break
    return reference, np.linalg.norm(points_mm - np.einsum("pn,pnx->px", t6_shape(reference), x), axis=1)


def _least_squares_step(
    tangent: Float[np.ndarray, "p 2 3"], right: Float[np.ndarray, "p 2"]
) -> Float[np.ndarray, "p 2"]:
    """(T T')^-1 right, T the two tangents of each face: a Gauss-Newton step in its reference coordinates."""
    a, b = np.moveaxis(tangent, 1, 0)
    aa, ab, bb = (np.einsum("px,px->p", u, v) for u, v in ((a, a), (a, b), (b, b)))
    u, v = right.T
    return np.asarray(np.stack([bb * u - ab * v, aa * v - ab * u], axis=1) / (aa * bb - ab**2)[:, None])


def _faces_around(
    faces: Int[np.ndarray, "f 6"], of: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
    """Pairs (index in `of`, face) of each face of `of` and those that share a corner with it."""
    row = np.repeat(np.arange(len(faces)), 3)
    entries = (np.ones(len(row), dtype=np.int64), (row, faces[:, :3].ravel()))
    holds = coo_array(entries, shape=(len(faces), int(faces.max()) + 1)).tocsr()
    pairs = (holds[of] @ holds.T).tocoo()
    return np.asarray(pairs.row, dtype=np.int64), np.asarray(pairs.col, dtype=np.int64)


def _into_triangle(reference: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p 2"]:
    """Reference coordinates kept in the triangle: negative barycentric ones become zero, then scaled."""
    weights = np.maximum(np.column_stack([1 - reference.sum(axis=1), reference]), 0.0)
    return np.asarray(weights[:, 1:] / weights.sum(axis=1, keepdims=True))

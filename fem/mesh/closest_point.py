"""Closest points on a triangle surface, exactly, for many points at once."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

BAND = 0.7
"""Size of a band's smallest triangle over its largest's. Set by hand, for time alone: the answer is exact
whatever the bands are."""
LEAST_BAND = 0.05
"""Triangles smaller than this share of the largest are one band. Set by hand, as BAND."""

FEW = 100
"""Points up to this number are compared with every triangle: search trees would take longer to build. Set by
hand, for time alone."""
NEIGHBOURS = 16
"""Nearest middles of a band that are tried first. Set by hand, for time alone."""


class Closest(NamedTuple):
    """Where points land on a triangle surface: triangle, barycentric coordinates in it, place, distance."""

    face: Int[np.ndarray, " p"]
    barycentric: Float[np.ndarray, "p 3"]
    point_mm: Float[np.ndarray, "p 3"]
    distance_mm: Float[np.ndarray, " p"]


@dataclass(frozen=True)
class TriangleSearch:
    """A triangle surface made ready to be asked for closest points again and again.

    `centre`, `radius`: of balls that hold its triangles.
    """

    corner: Float[np.ndarray, "f 3 3"]
    centre: Float[np.ndarray, "f 3"]
    radius: Float[np.ndarray, " f"]

    @classmethod
    def of(cls, vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> "TriangleSearch":
        """The triangles and their balls."""
        corner = vertices_mm[faces]
        centre = corner.mean(axis=1)
        return cls(corner, centre, np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1))

    @cached_property
    def middles(self) -> cKDTree:
        """The search tree of the triangles' middles."""
        return cKDTree(self.centre)

    @cached_property
    def bands(self) -> tuple[tuple[Int[np.ndarray, " _"], cKDTree, float], ...]:
        """The triangles by size, each band with the search tree of its middles, and its greatest radius.

        The large ones of a surface must not make every small one that is as near be tried.
        """
        band = np.ceil(np.log(np.maximum(self.radius / self.radius.max(), LEAST_BAND)) / np.log(BAND))
        members = [np.flatnonzero(band == level) for level in np.unique(band)]
        return tuple(
            (triangles, cKDTree(self.centre[triangles]), float(self.radius[triangles].max()))
            for triangles in members
        )

    def closest(self, points_mm: Float[np.ndarray, "p 3"]) -> Closest:
        """The closest point of the surface to each point, of several triangles as close the first.

        Every triangle that can hold it is tried: those whose circumscribed ball reaches within the distance
        to the triangle with the nearest middle.
        """
        if not len(points_mm):
            return Closest(np.empty(0, dtype=np.int64), points_mm.copy(), points_mm.copy(), np.empty(0))
        few = len(points_mm) <= FEW
        if few:
            apart = cdist(points_mm, self.centre)
            bound, nearest = apart.min(axis=1), apart.argmin(axis=1)
        else:
            bound, nearest = self.middles.query(points_mm)
        face = np.asarray(nearest, dtype=np.int64)
        best, weights = _closest_in_triangle(points_mm, self.corner[face])
        distance = np.linalg.norm(points_mm - best, axis=1)
        bound = np.minimum(bound, distance)
        if few:
            owner, tried = np.nonzero(apart <= bound[:, None] + self.radius)
        else:
            pairs = [self._within(points_mm, bound, *band) for band in self.bands]
            owner, tried = (np.concatenate(part) for part in zip(*pairs, strict=True))
        spot, spot_weights = _closest_in_triangle(points_mm[owner], self.corner[tried])
        reach = np.linalg.norm(points_mm[owner] - spot, axis=1)
        order = np.lexsort((tried, reach, owner))
        first = order[np.r_[True, owner[order][1:] != owner[order][:-1]]]
        at = owner[first]
        face[at], weights[at] = tried[first], spot_weights[first]
        best[at], distance[at] = spot[first], reach[first]
        return Closest(face, weights, best, distance)

    def _within(
        self,
        points_mm: Float[np.ndarray, "p 3"],
        bound: Float[np.ndarray, " p"],
        members: Int[np.ndarray, " _"],
        tree: cKDTree,
        largest_mm: float,
    ) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
        """Pairs (point, triangle of the band) whose ball reaches within the point's bound.

        The nearest middles are asked for, and more of them for points whose last one is still in reach.
        """
        left, count = np.arange(len(points_mm)), NEIGHBOURS
        owner, tried = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        while len(left):
            count = min(count, tree.n)
            distance, at = map(np.asarray, tree.query(points_mm[left], k=np.arange(1, count + 1)))
            ends = (distance[:, -1] > bound[left] + largest_mm) | (count == tree.n)
            near = (distance <= bound[left, None] + self.radius[members[at]]) & ends[:, None]
            who, which = np.nonzero(near)
            owner.append(left[who])
            tried.append(members[at[who, which]])
            left, count = left[~ends], 4 * count
        return np.concatenate(owner), np.concatenate(tried)


def closest_on_triangles(
    points_mm: Float[np.ndarray, "p 3"], vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Closest:
    """The closest point of the surface to each point (TriangleSearch), where it is asked for once."""
    return TriangleSearch.of(vertices_mm, faces).closest(points_mm)


def _closest_in_triangle(
    point: Float[np.ndarray, "p 3"], corner: Float[np.ndarray, "p 3 3"]
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """The closest point of one triangle to one point, pair by pair: in the plane, else on an edge."""
    a, ab, ac = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    ap = point - a
    d00, d01, d11 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    p0, p1 = _dot(ap, ab), _dot(ap, ac)
    det = np.maximum(d00 * d11 - d01**2, np.finfo(float).tiny)
    v, w = (d11 * p0 - d01 * p1) / det, (d00 * p1 - d01 * p0) / det
    weights = np.stack([1 - v - w, v, w], axis=1)
    outside = np.flatnonzero((weights < 0).any(axis=1))
    if len(outside):
        weights[outside] = _closest_on_edges(point[outside], corner[outside])
    return np.einsum("pk,pkx->px", weights, corner), weights


def _closest_on_edges(
    point: Float[np.ndarray, "p 3"], corner: Float[np.ndarray, "p 3 3"]
) -> Float[np.ndarray, "p 3"]:
    """Barycentric coordinates of the closest point on the triangle's border."""
    along = np.roll(corner, -1, axis=1) - corner
    arm = point[:, None] - corner
    length2 = np.maximum(np.einsum("pex,pex->pe", along, along), np.finfo(float).tiny)
    t = np.clip(np.einsum("pex,pex->pe", arm, along) / length2, 0, 1)
    rows, edge = np.arange(len(point)), np.linalg.norm(arm - t[..., None] * along, axis=2).argmin(axis=1)
    weights = np.zeros((len(point), 3))
    weights[rows, edge], weights[rows, (edge + 1) % 3] = 1 - t[rows, edge], t[rows, edge]
    return weights


def enclosed_volume_mm3(vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """The volume inside a closed surface with outward normals: the sum of a . (b x c) / 6."""
    a, b, c = np.moveaxis(vertices_mm[faces] - vertices_mm.mean(axis=0), 1, 0)
    return float(_dot(a, np.cross(b, c)).sum() / 6)


def _dot(a: Float[np.ndarray, "p 3"], b: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
    return np.asarray(np.einsum("px,px->p", a, b))

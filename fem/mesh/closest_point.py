"""Closest points on a triangle surface, exactly, for many points at once."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree


class Closest(NamedTuple):
    """Where points land on a triangle surface: triangle, barycentric coordinates in it, place, distance."""

    face: Int[np.ndarray, " p"]
    barycentric: Float[np.ndarray, "p 3"]
    point_mm: Float[np.ndarray, "p 3"]
    distance_mm: Float[np.ndarray, " p"]


def closest_on_triangles(
    points_mm: Float[np.ndarray, "p 3"], vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Closest:
    """The closest point of the surface to each point.

    Every triangle that can hold it is tried: those whose circumscribed ball reaches within the distance to
    the nearest triangle centre.
    """
    if not len(points_mm):
        return Closest(np.empty(0, dtype=np.int64), points_mm.copy(), points_mm.copy(), np.empty(0))
    corner = vertices_mm[faces]
    centre = corner.mean(axis=1)
    radius = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
    tree = cKDTree(centre)
    bound, nearest = tree.query(points_mm)
    face = np.asarray(nearest, dtype=np.int64)
    best, weights = _closest_in_triangle(points_mm, corner[face])
    distance = np.linalg.norm(points_mm - best, axis=1)
    bound = np.minimum(bound, distance)
    lists = tree.query_ball_point(points_mm, bound + radius.max())
    count = np.fromiter((len(found) for found in lists), dtype=np.int64, count=len(lists))
    owner = np.repeat(np.arange(len(points_mm)), count)
    tried = np.concatenate([np.asarray(found, dtype=np.int64) for found in lists])
    near = np.linalg.norm(points_mm[owner] - centre[tried], axis=1) <= bound[owner] + radius[tried]
    owner, tried = owner[near], tried[near]
    spot, spot_weights = _closest_in_triangle(points_mm[owner], corner[tried])
    reach = np.linalg.norm(points_mm[owner] - spot, axis=1)
    order = np.lexsort((tried, reach, owner))
    first = order[np.r_[True, owner[order][1:] != owner[order][:-1]]]
    at = owner[first]
    face[at], weights[at], best[at], distance[at] = (
        tried[first],
        spot_weights[first],
        spot[first],
        reach[first],
    )
    return Closest(face, weights, best, distance)


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
    best = np.full(len(point), np.inf)
    weights = np.zeros((len(point), 3))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, along = corner[:, i], corner[:, j] - corner[:, i]
        t = np.clip(_dot(point - start, along) / np.maximum(_dot(along, along), np.finfo(float).tiny), 0, 1)
        gap = np.linalg.norm(point - start - t[:, None] * along, axis=1)
        closer = gap < best
        best[closer] = gap[closer]
        weights[closer] = 0
        weights[closer, i], weights[closer, j] = 1 - t[closer], t[closer]
    return weights


def enclosed_volume_mm3(vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """The volume inside a closed surface with outward normals: the sum of a . (b x c) / 6."""
    a, b, c = np.moveaxis(vertices_mm[faces] - vertices_mm.mean(axis=0), 1, 0)
    return float(_dot(a, np.cross(b, c)).sum() / 6)


def _dot(a: Float[np.ndarray, "p 3"], b: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
    return np.asarray(np.einsum("px,px->p", a, b))

"""The outline surface as relief works on it: a coarser level of the ball, curvature, sets of vertices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.silhouettes.hull import ball
from recon.surface.photo_consistency import PATCH_STEP_PX, SIDE, GreyView, Patches
from recon.triangle_mesh import neighbour_mean, parts_of, sides_of, smoothed, vertex_normals

FLAT, ROUND = 0.45, 0.85
"""Convexity (mean curvature times radius) up to where a surface may be a bridge, and from where it is none:
0.0 to 0.56 (10 to 90 %) where true skin lies over 0.5 mm deeper, 0.83 to 1.2 where it lies within 0.1 mm."""
CURVATURE_ROUNDS = 6
"""Times that curvature is averaged with the neighbours': over a fifth of the radius."""
MOST_CURVATURE = 3.0
"""Largest curvature (inverse radii): a patch bent more than that is noise of the mesh."""


@dataclass(frozen=True)
class OutlineMesh:
    """A coarser level of the surface, its radius, and its even split into the next."""

    level: int
    faces: Int[np.ndarray, "m 3"]
    outline: Patches
    radius_mm: float


def outline_mesh(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], level: int
) -> OutlineMesh:
    """The surface at a coarser level of `ball`."""
    count = 10 * 4**level + 2
    points, normals = vertices[:count], vertex_normals(vertices, faces)[:count]
    radius = float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    coarser = ball(level)[1]
    return OutlineMesh(
        level, coarser, Patches(points, normals, mean_curvature(points, normals, coarser)), radius
    )


def heights_mm(mesh: OutlineMesh, moved: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """How far a surface lies outside the outline surface, mm."""
    return np.asarray(np.einsum("ij,ij->i", moved - mesh.outline.points, mesh.outline.normals))


def patches_of(mesh: OutlineMesh, surface: Float[np.ndarray, "n 3"]) -> Patches:
    """A patch at each vertex of a surface on the mesh's faces."""
    normals = vertex_normals(surface, mesh.faces)
    return Patches(surface, normals, mean_curvature(surface, normals, mesh.faces))


def vertices_per_patch(mesh: OutlineMesh, views: Sequence[GreyView]) -> float:
    """How many vertices share one patch; under 1 they are further apart than patches are wide."""
    points = mesh.outline.points
    pixel_mm = np.median([v.camera.pixel_mm(points) for v in views])
    patch_mm2 = float((SIDE - 1) * PATCH_STEP_PX * pixel_mm) ** 2
    return patch_mm2 * len(points) / (4 * np.pi * mesh.radius_mm**2)


def connected_parts(
    where: Bool[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]
) -> list[Bool[np.ndarray, " n"]]:
    """The connected parts of a set of vertices."""
    edges = sides_of(faces)
    label = parts_of(edges[where[edges].all(axis=1)], len(where))
    return [where & (label == part) for part in np.unique(label[where])]


def grown(where: Bool[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"], rings: int) -> Bool[np.ndarray, " n"]:
    """A set of vertices and so many rings of neighbours around it."""
    step = neighbour_mean(faces, len(where))
    for _ in range(rings):
        where = where | (step @ where.astype(float) > 0)
    return where


def roundness(bending: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """1 where a surface (mean curvature in inverse radii, negative if convex) bulges, 0 where it is flat.

    Outlines bridge a hollow from lip to lip with a piece that is flat across: what is flat may be a bridge.
    """
    return np.asarray(np.clip((-bending - FLAT) / (ROUND - FLAT), 0.0, 1.0))


def mean_curvature(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """Mean curvature (1/mm, convex < 0): mean of 2 n . (x_j - x_i) / |x_j - x_i|² over neighbours j."""
    i, j = sides_of(faces).T
    step = points[j] - points[i]
    each = 2 * np.einsum("ij,ij->i", step, normals[i]) / np.sum(step**2, axis=1)
    mean = np.bincount(i, each, len(points)) / np.bincount(i, minlength=len(points))
    mean = smoothed(mean, faces, CURVATURE_ROUNDS)
    limit = MOST_CURVATURE / float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    return np.asarray(np.clip(mean, -limit, limit))

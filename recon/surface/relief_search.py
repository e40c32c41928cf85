"""Search for relief in half of the views, on a coarser level of the ball: depths by photo-consistency, and a
membrane between.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse

from recon.silhouettes.hull import ball
from recon.surface.photo_consistency import (
    DISTINCT_STEPS,
    PATCH_STEP_PX,
    SIDE,
    GreyView,
    Patches,
    agreement,
    best_offsets,
)
from recon.triangle_mesh import (
    Faces,
    Vertices,
    neighbour_mean,
    parts_of,
    sides_of,
    smoothed,
    solved,
    vertex_normals,
)

FLAT, ROUND = 0.45, 0.85
"""Convexity (mean curvature times radius) below which a surface may bridge a hollow, and above which it is
true skin. It is 0.0 to 0.56 (10 to 90 %) where true skin lies over 0.5 mm deeper, 0.83 to 1.2 where it lies
within 0.1 mm."""
CURVATURE_ROUNDS = 6
"""Smoothing rounds of the curvature: over a fifth of the radius."""
MOST_CURVATURE = 3.0
"""Largest curvature (inverse radii): a patch bent more than that is noise of the mesh."""


@dataclass(frozen=True)
class OutlineMesh:
    """The outline surface at a coarser level of `ball`, and its radius."""

    level: int
    faces: Faces
    outline: Patches
    radius_mm: float


def outline_mesh(vertices: Vertices, faces: Faces, level: int) -> OutlineMesh:
    """The surface at a coarser level of `ball`."""
    count = 10 * 4**level + 2
    points, normals = vertices[:count], vertex_normals(vertices, faces)[:count]
    radius = float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    coarser = ball(level)[1]
    return OutlineMesh(
        level, coarser, Patches(points, normals, mean_curvature(points, normals, coarser)), radius
    )


def heights_mm(mesh: OutlineMesh, moved: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Height of a surface above the outline surface, along the latter's normals, mm."""
    return np.asarray(np.einsum("ij,ij->i", moved - mesh.outline.points, mesh.outline.normals))


def patches_of(mesh: OutlineMesh, surface: Float[np.ndarray, "n 3"]) -> Patches:
    """A patch at each vertex of a surface on the mesh's faces."""
    normals = vertex_normals(surface, mesh.faces)
    return Patches(surface, normals, mean_curvature(surface, normals, mesh.faces))


def vertices_per_patch(mesh: OutlineMesh, views: Sequence[GreyView]) -> float:
    """Number of vertices per patch; under 1 they are further apart than patches are wide."""
    points = mesh.outline.points
    pixel_mm = np.median([v.camera.pixel_mm(points) for v in views])
    patch_mm2 = float((SIDE - 1) * PATCH_STEP_PX * pixel_mm) ** 2
    return patch_mm2 * len(points) / (4 * np.pi * mesh.radius_mm**2)


def connected_parts(where: Bool[np.ndarray, " n"], faces: Faces) -> list[Bool[np.ndarray, " n"]]:
    """The connected parts of a set of vertices."""
    edges = sides_of(faces)
    label = parts_of(edges[where[edges].all(axis=1)], len(where))
    return [where & (label == part) for part in np.unique(label[where])]


def grown(where: Bool[np.ndarray, " n"], faces: Faces, rings: int) -> Bool[np.ndarray, " n"]:
    """A set of vertices and `rings` rings of neighbours around it."""
    step = neighbour_mean(faces, len(where))
    for _ in range(rings):
        where = where | (step @ where.astype(float) > 0)
    return where


def roundness(bending: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """1 where a surface (mean curvature in inverse radii, negative if convex) bulges, 0 where it is flat.

    Outlines bridge a hollow from lip to lip with a flat piece, so that a flat surface may be a bridge.
    """
    return np.asarray(np.clip((-bending - FLAT) / (ROUND - FLAT), 0.0, 1.0))


def mean_curvature(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], faces: Faces
) -> Float[np.ndarray, " n"]:
    """Mean curvature (1/mm, convex < 0): mean of 2 n . (x_j - x_i) / |x_j - x_i|² over neighbours j."""
    i, j = sides_of(faces).T
    step = points[j] - points[i]
    each = 2 * np.einsum("ij,ij->i", step, normals[i]) / np.sum(step**2, axis=1)
    mean = np.bincount(i, each, len(points)) / np.bincount(i, minlength=len(points))
    mean = smoothed(mean, faces, CURVATURE_ROUNDS)
    limit = MOST_CURVATURE / float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    return np.asarray(np.clip(mean, -limit, limit))


@dataclass(frozen=True, kw_only=True)
class Search:
    """Offsets along the normals, in radii of the fruit, from the outline surface or the one moved before."""

    highest: float
    lowest: float
    steps: int
    from_moved: bool


COARSE_SEARCHES = (
    Search(highest=0.015, lowest=-0.2, steps=24, from_moved=False),
    Search(highest=0.015, lowest=-0.2, steps=24, from_moved=False),
    Search(highest=0.05, lowest=-0.07, steps=14, from_moved=True),
)
"""The whole range (stem cavities are up to 0.19 radii deep), again with slopes, then near the result."""
FINE_SEARCH = Search(highest=0.04, lowest=-0.05, steps=12, from_moved=True)
"""Offsets (radii) on the finer mesh: steps of 0.2 mm on a peach, under a pixel of the photos."""
STEM_COSINE = 0.75
"""Cosine between normal and vertical below which skin is a side, where no stem is."""
SHALLOW_SHARE = 0.055
"""Largest depth (radii) of skin under the outlines on sides (normal over 41 degrees off the vertical)."""
STIFFNESS = 1.2
"""Stiffness of the membrane against the weight (at most 1) of a depth: a single one does not bend it."""
AVERAGED, LESS_AVERAGED = (2, 2, 2), (1, 1, 1)
"""Smoothing rounds of the scores, by search of COARSE_SEARCHES. Two suppress noise of glossy skin, but smear
peaks of steep slopes. One is tried after two found nothing: on 18 photos of a nectarine 21 of 79 vertices of
the cavity then passed, 2 before."""
FINE_STIFFNESS, FINE_AVERAGED, FINE_PULL = 5.0, 5, 0.02
"""Stiffness and smoothing rounds on the finer mesh, over about as many millimetres; weight of the pull back
to the surface before. 2 to 5 rounds and stiffness 1.5 to 5 differ by under 0.003 mm on six sets."""
EVERYWHERE, LOOSE = 0.02, 2e-4
"""Weight of the pull back to the outline surface, for all vertices and for those in a hollow. Against a
depth's 0.16 to 1 the first costs an eighth at most; alone it returns vertices without a depth."""
HOLLOW_SHARE = 0.02
"""Depth (radii) above which a vertex counts as deep: 0.6 mm on a peach, twice the outlines' own error."""
HOLLOW_DENSITY, HOLLOW_SURE = 0.25, 0.6
"""Least share of deep vertices among those nearby, and among those with a depth, for a hollow."""
HOLLOW_ROUNDS = 3
"""Smoothing rounds that define "nearby", about 12 degrees of the fruit."""
MOVED_SHARE = 0.01
"""Least move of a vertex that counts (radii): a third of a millimetre on a peach, the outlines' own error."""
GROWTH_RINGS = 3
"""Rings around moved vertices that are searched next: a hollow's slopes are found from its floor."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """Result of a search: the surface, the weight of each vertex's depth (0: without one), and the vertices
    that might move. `far`: those far from the outline surface (with a depth, or between such).
    """

    surface: Float[np.ndarray, "n 3"]
    weight: Float[np.ndarray, " n"]
    active: Bool[np.ndarray, " n"]
    far: Bool[np.ndarray, " n"]


def searched(
    mesh: OutlineMesh,
    views: Sequence[GreyView],
    active: Bool[np.ndarray, " n"],
    held: Float[np.ndarray, " n"],
    *,
    averaged: tuple[int, ...],
) -> Found:
    """The outline surface, moved at active vertices.

    Three searches: over the whole range with the outline surface's normals, again with normals halfway to the
    found hollow's, then near the result. `averaged`: smoothing rounds of the scores, by search. `held` pulls
    vertices back to the outlines, except where photos agree all around that the skin lies deep.
    """
    points, radius, faces = mesh.outline.points, mesh.radius_mm, mesh.faces
    moved, patches, rows = points, mesh.outline, np.flatnonzero(active)
    weight, hollow = np.zeros(len(points)), np.zeros(len(points))
    for search, times in zip(COARSE_SEARCHES, averaged, strict=True):
        base = moved if search.from_moved else points
        normals = patches.normals
        offsets = np.linspace(search.highest, search.lowest, search.steps) * radius
        height = np.einsum("ij,ij->i", base - points, normals)
        patches = Patches(base, normals, patches.curvature)
        if len(rows) == 0:
            break
        scores = _spread_scores(patches, views, rows, offsets)
        side = np.abs(normals[:, 2]) < STEM_COSINE
        scores[:, side] *= (height[:, None] + offsets > -SHALLOW_SHARE * radius)[side]
        offset, weight = best_offsets(_averaged(scores, faces, times), offsets)
        weight[~active] = 0.0
        relief_mm = height + offset
        hollow = np.maximum(hollow, _hollow(relief_mm < -HOLLOW_SHARE * radius, weight > 0, faces))
        pull = LOOSE + (EVERYWHERE + held) * (1 - hollow) ** 4
        smooth = _membrane(relief_mm, weight, pull, active, faces, STIFFNESS)
        moved = base + (smooth - height)[:, None] * normals
        rows = np.flatnonzero(active & grown(np.abs(smooth) > MOVED_SHARE * radius, faces, GROWTH_RINGS))
        turned = vertex_normals(moved, faces)
        between = normals + turned
        mixed = turned if search.from_moved else between / np.linalg.norm(between, axis=1, keepdims=True)
        patches = Patches(moved, mixed, mean_curvature(moved, turned, faces))
    far = np.abs(heights_mm(mesh, moved)) > MOVED_SHARE * radius
    return Found(surface=moved, weight=weight, active=active, far=far)


def refined(
    mesh: OutlineMesh,
    surface: Float[np.ndarray, "n 3"],
    views: Sequence[GreyView],
    zone: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """A surface moved smoothly inside a zone, by 0 without depths nearby; and the mask of found depths."""
    patches, rows = patches_of(mesh, surface), np.flatnonzero(zone)
    offsets = np.linspace(FINE_SEARCH.highest, FINE_SEARCH.lowest, FINE_SEARCH.steps) * mesh.radius_mm
    scores = _averaged(_spread_scores(patches, views, rows, offsets), mesh.faces, FINE_AVERAGED)
    offset, weight = best_offsets(scores, offsets)
    weight[~zone] = 0.0
    pull = np.full(len(weight), FINE_PULL)
    step = _membrane(offset, weight, pull, zone, mesh.faces, FINE_STIFFNESS)
    return surface + step[:, None] * patches.normals, weight > 0


def at_edge(mesh: OutlineMesh, surface: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Vertices about as deep under the outlines as `searched` reaches, so that the skin may lie deeper.

    A peak is distinct only if scores more than DISTINCT_STEPS steps away are lower, so the deepest steps hold
    no distinct peak. On sides, deeper scores count as 0, and only the last step is at the edge.
    """
    whole = COARSE_SEARCHES[0]
    step = (whole.highest - whole.lowest) / (whole.steps - 1)
    side = np.abs(mesh.outline.normals[:, 2]) < STEM_COSINE
    edge = np.where(side, SHALLOW_SHARE - step, -whole.lowest - (DISTINCT_STEPS + 1) * step)
    return np.asarray(heights_mm(mesh, surface) < -edge * mesh.radius_mm)


def _spread_scores(
    patches: Patches,
    views: Sequence[GreyView],
    rows: Int[np.ndarray, " r"],
    offsets_mm: Float[np.ndarray, " d"],
) -> Float[np.ndarray, "k n d"]:
    """`agreement` of some patches, 0 for the others."""
    scores, _ = agreement(patches[rows], views, offsets_mm)
    every = np.zeros((len(scores), len(patches.points), len(offsets_mm)))
    every[:, rows] = scores
    return every


def _averaged(scores: Float[np.ndarray, "k n d"], faces: Faces, times: int) -> Float[np.ndarray, "k n d"]:
    """Scores averaged with the neighbours', `times` times."""
    return np.stack([smoothed(each, faces, times) for each in scores])


def _hollow(
    deep: Bool[np.ndarray, " n"], trusted: Bool[np.ndarray, " n"], faces: Faces
) -> Float[np.ndarray, " n"]:
    """1 where photos agree all around that the skin lies deep under the outlines, else 0; soft between."""
    step = neighbour_mean(faces, len(deep))
    sure, low = (smoothed(w.astype(float), faces, HOLLOW_ROUNDS) for w in (trusted, trusted & deep))
    hollow = ((low > HOLLOW_DENSITY) & (low > HOLLOW_SURE * sure)).astype(float)
    for _ in range(HOLLOW_ROUNDS):
        hollow = np.maximum(hollow, np.minimum(1.0, 1.5 * (step @ hollow)))
    return np.asarray(hollow)


def _membrane(
    offset: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    pull: Float[np.ndarray, " n"],
    free: Bool[np.ndarray, " n"],
    faces: Faces,
    stiffness: float,
) -> Float[np.ndarray, " n"]:
    """argmin sum w (x - offset)² + pull x² + 4 stiffness |x - mean of neighbours|², 0 where not free."""
    out = np.zeros(len(offset))
    if not free.any():
        return out
    bend = sparse.csc_array(sparse.identity(len(offset)) - neighbour_mean(faces, len(offset)))[:, free]
    A = sparse.diags((weight + pull)[free]) + 4 * stiffness * (bend.T @ bend)
    out[free] = solved(A, (weight * offset)[free])
    return out

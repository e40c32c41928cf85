"""Relief that no silhouette shows (the stem cavity, a suture): the outline surface moved along its normals to
where photos agree, kept only where photos that took no part in the search agree better than before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.stats import binom

from recon.camera import Camera
from recon.closed import neighbour_mean, vertex_normals
from recon.hull import ball, split
from recon.photo_consistency import (
    FEWEST_VIEWS,
    PATCH_STEP_PX,
    SIDE,
    Patches,
    View,
    agreement,
    best_offsets,
    grey_views,
    views_facing,
)


@dataclass(frozen=True, kw_only=True)
class Search:
    """Offsets along the normals, in radii of the fruit, from the surface given or as moved before."""

    highest: float
    lowest: float
    steps: int
    from_moved: bool


COARSE_SEARCHES = (
    Search(highest=0.015, lowest=-0.2, steps=24, from_moved=False),
    Search(highest=0.015, lowest=-0.2, steps=24, from_moved=False),
    Search(highest=0.05, lowest=-0.07, steps=14, from_moved=True),
)
"""Twice the whole range (stem cavities are up to 0.19 radii deep under the outlines), since slopes known from
the first make the second find more; then near what was found."""
FINE_SEARCH = Search(highest=0.04, lowest=-0.05, steps=12, from_moved=True)
MOST_ROUNDS = 4
COARSE, FINE = 4, 5
STEM_COSINE = 0.75
SHALLOW_SHARE = 0.055
"""On sides (normal over 41 degrees off the vertical) skin lies at most so far (radii) under the outlines: a
suture, never a stem cavity."""
STIFFNESS, SHARED = 1.2, 2
FINE_STIFFNESS, FINE_SHARED, FINE_PULL = 5.0, 5, 0.02
"""Stiffness against depth found, and how often scores are averaged with neighbours': on the finer mesh over
about as many millimetres."""
SUPPORT_WEIGHT = 5.0
EVERYWHERE, LOOSE = 0.02, 2e-4
FLAT, ROUND = 0.45, 0.85
"""Convexity (mean curvature times radius) up to where a surface may be a bridge, and from where it is none:
0.0 to 0.56 (10 to 90 %) where true skin lies over 0.5 mm deeper, 0.83 to 1.2 where it lies within 0.1 mm."""
HELD_SHARE, RIM_RINGS, GROWTH_RINGS, ZONE_RINGS = 0.2, 2, 3, 3
"""Vertices held by under a fifth of what rims hold the median one may move, and so many rings around them;
then so many rings around what moved are searched next, and refined if kept."""
HOLLOW_SHARE = 0.02
HOLLOW_DENSITY = 0.25
HOLLOW_SPREADING = 3
MOVED_SHARE = 0.01
"""Radii that a vertex must move to count: a third of a millimetre on a peach, the outlines' own error."""
LEAST_GAIN = 0.05
LEAST_MEAN_GAIN = 0.03
CHANCE = 1e-2
"""Rise of correlation in the held-out views that confirms a vertex; mean rise over a region, and how probable
it may be by chance. On 16 sets the stem cavities had 2.6e-3 or less, what is refused 1.4e-2 or more:

    python benchmarks/recon_relief.py FOLDER... --set CHANCE=1.1
"""
LEAST_AGAIN_GAIN, LEAST_FINE_GAIN = 0.05, 0.02
"""Mean rise that a search on the finer mesh must bring over the whole range, and near the surface found. True
improvements brought 0.099 and 0.28 over the whole range; one on mirror images, wrong by 0.2 mm, 0.034:

    python benchmarks/recon_relief.py FOLDER... --set LEAST_AGAIN_GAIN=0.0 --set LEAST_FINE_GAIN=0.0
"""


@dataclass(frozen=True, kw_only=True)
class Region:
    """A connected patch that the search moved, and what the held-out views say of it.

    `measured` of its `vertices` (of the coarse mesh) have a depth of their own, `confirmed` of these explain
    the held-out views better than the outline surface does; `mean_gain` is by how much (correlation),
    `chance` how likely so many are where the outline surface is certain.
    """

    centre_mm: Float[np.ndarray, "3"]
    depth_mm: float
    vertices: int
    measured: int
    confirmed: int
    mean_gain: float
    chance: float
    accepted: bool


@dataclass(frozen=True, kw_only=True)
class Relief:
    """A surface with its relief, and what is known of it at each vertex.

    `measured`: placed by photos that agree, in a region that held-out views confirm. `bridged`: 1 where the
    outline surface is so flat that outlines may bridge a hollow, 0 where it is round; where it is high and
    `measured` is not, the skin may lie deeper by more than the outlines' error tells.
    """

    vertices: Float[np.ndarray, "n 3"]
    measured: Bool[np.ndarray, " n"]
    bridged: Float[np.ndarray, " n"]
    regions: tuple[Region, ...]


@dataclass(frozen=True)
class _Mesh:
    """A coarser level of the surface, its radius, and its even split into the next."""

    level: int
    faces: Int[np.ndarray, "m 3"]
    outline: Patches
    radius_mm: float


def with_relief(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    *,
    support: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """`relief`'s vertices, and the share of them that it measured."""
    found = relief(vertices, faces, images, cameras, support=support)
    return found.vertices, float(found.measured.mean())


def relief(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    *,
    support: Float[np.ndarray, " n"],
) -> Relief:
    """A surface on `ball`'s directions, moved where photos show that outlines bridge a hollow.

    Only vertices that few rims hold (`support`) or where the surface is flat may move, and only where at
    least three of every second view and three of the others face them. The first half of the views is
    searched: for each vertex a small patch, bent as the surface is, slides along the normal to where the
    views' mean pairwise correlation is highest, and a membrane on the mesh fills between high and distinct
    peaks. The second half judges each connected region that moved: a vertex confirms it where its correlation
    in the held-out views is higher by LEAST_GAIN than on the outline surface. The same search run where rims
    hold a round surface, which relief cannot improve, tells how often that happens by chance p0 (per patch,
    (k0 + 1) / (n0 + 2): Laplace); a region is kept where the binomial tail P(K >= k; n, p0) is under CHANCE,
    everything else stays on the outlines. Regions kept are searched again near the surface found on a finer
    mesh (over the whole range where coarse vertices are further apart than patches are wide), each time only
    while the held-out views agree better with what comes out.
    """
    finer = round(np.log(max(len(vertices) - 2, 10) / 10) / np.log(4))
    coarse = _level(vertices, faces, min(COARSE, finer))
    count = len(coarse.outline.points)
    roundness = _rounded(coarse.outline.curvature * coarse.radius_mm)
    bridged = np.clip(split(1 - roundness[:, None], coarse.level, finer)[:, 0], 0.0, 1.0)
    nothing = Relief(vertices=vertices, measured=np.zeros(len(vertices), bool), bridged=bridged, regions=())
    views = grey_views(images, cameras)
    searched, held_out = views[::2], views[1::2]
    if len(held_out) < FEWEST_VIEWS:
        return nothing
    seen = np.minimum(views_facing(coarse.outline, searched), views_facing(coarse.outline, held_out))
    seen_enough = seen >= FEWEST_VIEWS
    if not seen_enough.any():
        return nothing
    held = support[:count] * roundness
    loose = seen_enough & (held < HELD_SHARE * np.median(held[seen_enough]))
    loose = seen_enough & _grown(loose, coarse.faces, RIM_RINGS)
    moved, weight = _searched(coarse, searched, loose, SUPPORT_WEIGHT * held)
    far = np.abs(_heights(coarse, moved)) > MOVED_SHARE * coarse.radius_mm
    if not (far & (weight > 0)).any():
        return nothing
    certain = seen_enough & ~_grown(loose, coarse.faces, 1) & (roundness > 0.9)
    certain &= support[:count] > 0.5 * np.median(support[:count])
    null, null_weight = _searched(coarse, searched, certain, np.zeros(count))
    regions, kept = _judged(coarse, held_out, (moved, weight, far), (null, null_weight, certain))
    if not kept.any():
        return Relief(vertices=vertices, measured=nothing.measured, bridged=bridged, regions=regions)
    zone = _grown(kept, coarse.faces, ZONE_RINGS) & loose & ~(far & ~kept)
    if (far & ~zone).any():
        moved, weight = _searched(coarse, searched, zone, SUPPORT_WEIGHT * held)
    fine = _level(vertices, faces, min(FINE, finer))
    surface = fine.outline.points + split(moved - coarse.outline.points, coarse.level, fine.level)
    zone = split(zone[:, None].astype(float), coarse.level, fine.level)[:, 0] > 0.5
    measured = split((weight > 0)[:, None].astype(float), coarse.level, fine.level)[:, 0] > 0
    held = split(SUPPORT_WEIGHT * held[:, None], coarse.level, fine.level)[:, 0]
    if _patch_vertices(coarse, views) < 1:
        again, weight = _searched(fine, searched, zone, held)
        if _gain(fine, held_out, surface, again, zone) > LEAST_AGAIN_GAIN:
            surface, measured = again, measured | (weight > 0)
    for _ in range(MOST_ROUNDS):
        better, found = _refined(fine, surface, searched, zone)
        if _gain(fine, held_out, surface, better, zone) < LEAST_FINE_GAIN:
            break
        surface, measured = better, measured | found
    spread = split(measured[:, None].astype(float), fine.level, finer)[:, 0] > 0.25
    return Relief(
        vertices=vertices + split(surface - fine.outline.points, fine.level, finer),
        measured=spread,
        bridged=bridged,
        regions=regions,
    )


def _level(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], level: int) -> _Mesh:
    """The surface at a coarser level of `ball`."""
    count = 10 * 4**level + 2
    points, normals = vertices[:count], vertex_normals(vertices, faces)[:count]
    radius = float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    coarser = ball(level)[1]
    return _Mesh(level, coarser, Patches(points, normals, _curvature(points, normals, coarser)), radius)


def _heights(mesh: _Mesh, moved: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """How far a surface lies outside the outline surface, mm."""
    return np.asarray(np.einsum("ij,ij->i", moved - mesh.outline.points, mesh.outline.normals))


def _searched(
    mesh: _Mesh, views: Sequence[View], active: Bool[np.ndarray, " n"], held: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """The outline surface moved where vertices are active, and how sure each depth found is (0: none found).

    First over the whole range with normals of the outline surface, then with those of the hollow found, then
    near it. Vertices that rims hold are pulled back to them, but where photos agree all around that the skin
    lies deep.
    """
    points, radius, faces = mesh.outline.points, mesh.radius_mm, mesh.faces
    moved, patches, rows = points, mesh.outline, np.flatnonzero(active)
    weight, hollow = np.zeros(len(points)), np.zeros(len(points))
    for search in COARSE_SEARCHES:
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
        offset, weight = best_offsets(_shared(scores, faces, SHARED), offsets)
        weight[~active] = 0.0
        found = height + offset
        hollow = np.maximum(hollow, _hollow(found < -HOLLOW_SHARE * radius, weight > 0, faces))
        pull = LOOSE + (EVERYWHERE + held) * (1 - hollow) ** 4
        smooth = _membrane(found, weight, pull, active, faces, STIFFNESS)
        moved = base + (smooth - height)[:, None] * normals
        rows = np.flatnonzero(active & _grown(np.abs(smooth) > MOVED_SHARE * radius, faces, GROWTH_RINGS))
        turned = vertex_normals(moved, faces)
        mixed = turned if search.from_moved else _blend(normals, turned)
        patches = Patches(moved, mixed, _curvature(moved, turned, faces))
    return moved, weight


def _refined(
    mesh: _Mesh,
    surface: Float[np.ndarray, "n 3"],
    views: Sequence[View],
    zone: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """A surface moved further inside a zone, by a smooth step that is 0 where no depth is found; and where
    one was.
    """
    patches, rows = _patches(mesh, surface), np.flatnonzero(zone)
    offsets = np.linspace(FINE_SEARCH.highest, FINE_SEARCH.lowest, FINE_SEARCH.steps) * mesh.radius_mm
    scores = _shared(_spread_scores(patches, views, rows, offsets), mesh.faces, FINE_SHARED)
    offset, weight = best_offsets(scores, offsets)
    weight[~zone] = 0.0
    pull = np.full(len(weight), FINE_PULL)
    step = _membrane(offset, weight, pull, zone, mesh.faces, FINE_STIFFNESS)
    return surface + step[:, None] * patches.normals, weight > 0


def _judged(
    mesh: _Mesh,
    held_out: Sequence[View],
    moved: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]],
    null: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]],
) -> tuple[tuple[Region, ...], Bool[np.ndarray, " n"]]:
    """Each connected region that moved, judged by the views held out, and the vertices of those kept.

    `moved` is a surface, the weight of each depth in it and where it is far from the outlines; `null` the
    same of a search where the outlines are certain, with where that is.
    """
    surface, weight, far = moved
    count = len(weight)
    alike = max(1.0, _patch_vertices(mesh, held_out))
    gain = _gains(mesh, held_out, surface, far & (weight > 0))
    heights = _heights(mesh, surface)
    null_heights = _heights(mesh, null[0])
    null_far = (null[1] > 0) & (np.abs(null_heights) > MOVED_SHARE * mesh.radius_mm)
    null_gain = _gains(mesh, held_out, null[0], null_far)
    regions, kept = [], np.zeros(count, bool)
    for part in _connected(far, mesh.faces):
        measured = part & (weight > 0) & np.isfinite(gain)
        if not measured.any():
            continue
        depth = float(np.median(heights[measured]))
        by_chance = ((null_gain > LEAST_GAIN) & (np.abs(null_heights) > 0.5 * abs(depth))).sum() / alike
        p0 = (by_chance + 1) / (null[2].sum() / alike + 2)
        confirmed = int((gain[measured] > LEAST_GAIN).sum())
        patches_confirmed, patches = int(confirmed / alike), max(int(np.ceil(part.sum() / alike)), 1)
        chance = float(binom.sf(patches_confirmed - 1, patches, p0))
        mean = float(gain[measured].mean())
        accepted = chance < CHANCE and mean > LEAST_MEAN_GAIN
        regions.append(
            Region(
                centre_mm=mesh.outline.points[part].mean(0),
                depth_mm=-float(heights[part].min()),
                vertices=int(part.sum()),
                measured=int(measured.sum()),
                confirmed=confirmed,
                mean_gain=mean,
                chance=chance,
                accepted=accepted,
            )
        )
        kept |= part & accepted
    return tuple(regions), kept


def _gain(
    mesh: _Mesh,
    views: Sequence[View],
    before: Float[np.ndarray, "n 3"],
    after: Float[np.ndarray, "n 3"],
    zone: Bool[np.ndarray, " n"],
) -> float:
    """Mean rise of the correlation from one surface to another, over the patches of a zone seen on both."""
    rows = np.flatnonzero(zone)
    rise = _risen(_patches(mesh, before)[rows], _patches(mesh, after)[rows], views)
    return float(np.nanmean(rise)) if np.isfinite(rise).any() else 0.0


def _gains(
    mesh: _Mesh, views: Sequence[View], surface: Float[np.ndarray, "n 3"], where: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Rise of the correlation from the outline surface to another; nan elsewhere and where views do not
    tell.
    """
    gain, rows = np.full(len(surface), np.nan), np.flatnonzero(where)
    if len(rows):
        gain[rows] = _risen(mesh.outline[rows], _patches(mesh, surface)[rows], views)
    return gain


def _risen(before: Patches, after: Patches, views: Sequence[View]) -> Float[np.ndarray, " n"]:
    """Rise of the correlation, mean over the ways it is measured in on both surfaces; nan where in none."""
    here = np.zeros(1)
    (a, a_enough), (b, b_enough) = agreement(before, views, here), agreement(after, views, here)
    both = (a_enough & b_enough)[..., 0]
    rise = ((b - a)[..., 0] * both).sum(0) / np.maximum(both.sum(0), 1)
    return np.asarray(np.where(both.any(axis=0), rise, np.nan))


def _patches(mesh: _Mesh, surface: Float[np.ndarray, "n 3"]) -> Patches:
    normals = vertex_normals(surface, mesh.faces)
    return Patches(surface, normals, _curvature(surface, normals, mesh.faces))


def _patch_vertices(mesh: _Mesh, views: Sequence[View]) -> float:
    """How many vertices share one patch; under 1 they are further apart than patches are wide."""
    points = mesh.outline.points
    pixel_mm = np.median([np.median(v.camera.into(points)[:, 2]) / v.camera.focal_px for v in views])
    patch_mm2 = float((SIDE - 1) * PATCH_STEP_PX * pixel_mm) ** 2
    return patch_mm2 * len(points) / (4 * np.pi * mesh.radius_mm**2)


def _connected(where: Bool[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]) -> list[Bool[np.ndarray, " n"]]:
    """The connected parts of a set of vertices."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[where[edges].all(axis=1)]
    graph = sparse.coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(where),) * 2)
    label = connected_components(graph, directed=False)[1]
    return [where & (label == part) for part in np.unique(label[where])]


def _grown(
    where: Bool[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"], rings: int
) -> Bool[np.ndarray, " n"]:
    """A set of vertices and so many rings of neighbours around it."""
    step = neighbour_mean(faces, len(where))
    for _ in range(rings):
        where = where | (step @ where.astype(float) > 0)
    return where


def _spread_scores(
    patches: Patches, views: Sequence[View], rows: Int[np.ndarray, " r"], offsets_mm: Float[np.ndarray, " d"]
) -> Float[np.ndarray, "k n d"]:
    """`agreement` of some patches, 0 for the others."""
    scores, _ = agreement(patches[rows], views, offsets_mm)
    every = np.zeros((len(scores), len(patches.points), len(offsets_mm)))
    every[:, rows] = scores
    return every


def _shared(
    scores: Float[np.ndarray, "k n d"], faces: Int[np.ndarray, "m 3"], times: int
) -> Float[np.ndarray, "k n d"]:
    """Scores averaged with the neighbours', so many times."""
    step = neighbour_mean(faces, scores.shape[1])
    out = []
    for each in scores:
        for _ in range(times):
            each = 0.5 * (each + step @ each)
        out.append(each)
    return np.stack(out)


def _rounded(bending: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """1 where a surface (mean curvature in inverse radii, negative if convex) bulges, 0 where it is flat.

    Outlines bridge a hollow from lip to lip with a piece that is flat across: what is flat may be a bridge.
    """
    return np.asarray(np.clip((-bending - FLAT) / (ROUND - FLAT), 0.0, 1.0))


def _hollow(
    deep: Bool[np.ndarray, " n"], trusted: Bool[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """1 where the photos agree all around that the skin lies deep under the outlines, 0 elsewhere, soft
    between.
    """
    step = neighbour_mean(faces, len(deep))
    sure, low = trusted.astype(float), (trusted & deep).astype(float)
    for _ in range(HOLLOW_SPREADING):
        sure, low = 0.5 * (sure + step @ sure), 0.5 * (low + step @ low)
    hollow = ((low > HOLLOW_DENSITY) & (low > 0.6 * sure)).astype(float)
    for _ in range(HOLLOW_SPREADING):
        hollow = np.maximum(hollow, np.minimum(1.0, 1.5 * (step @ hollow)))
    return np.asarray(hollow)


def _curvature(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """Mean curvature, 1/mm, negative where convex: the mean of 2 n . (x_j - x_i) / |x_j - x_i|² over the
    neighbours j.
    """
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    step = points[j] - points[i]
    each = 2 * np.einsum("ij,ij->i", step, normals[i]) / np.sum(step**2, axis=1)
    mean = np.bincount(i, each, len(points)) / np.bincount(i, minlength=len(points))
    smooth = neighbour_mean(faces, len(points))
    for _ in range(6):
        mean = 0.5 * mean + 0.5 * (smooth @ mean)
    limit = 3 / float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    return np.asarray(np.clip(mean, -limit, limit))


def _membrane(
    offset: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    pull: Float[np.ndarray, " n"],
    free: Bool[np.ndarray, " n"],
    faces: Int[np.ndarray, "m 3"],
    stiffness: float,
) -> Float[np.ndarray, " n"]:
    """argmin sum w (x - offset)² + pull x² + 4 stiffness |x - mean of neighbours|² over the free vertices, 0
    at the others.
    """
    out = np.zeros(len(offset))
    if not free.any():
        return out
    bend = sparse.csc_array(sparse.identity(len(offset)) - neighbour_mean(faces, len(offset)))[:, free]
    A = sparse.csc_array(sparse.diags((weight + pull)[free]) + 4 * stiffness * (bend.T @ bend))
    solver = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    out[free] = solver.solve((weight * offset)[free])
    return out


def _blend(old: Float[np.ndarray, "n 3"], new: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    mixed = old + new
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))

"""Relief that no silhouette shows (stem cavity, suture): the outline surface is moved along its normals to
where photos agree. It is kept only where held-out photos agree better than before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from recon.cameras.camera import Camera
from recon.picture_values import Pictures
from recon.silhouettes.hull import split
from recon.surface.photo_consistency import (
    FEWEST_VIEWS,
    GreyView,
    Patches,
    agreement,
    grey_views,
    views_facing,
)
from recon.surface.relief_search import (
    AVERAGED,
    LESS_AVERAGED,
    Found,
    OutlineMesh,
    at_edge,
    connected_parts,
    grown,
    heights_mm,
    outline_mesh,
    patches_of,
    refined,
    roundness,
    searched,
    vertices_per_patch,
)
from recon.triangle_mesh import Faces, Vertices

LEAST_GAIN = 0.05
"""Rise of the correlation in the held-out views that confirms a vertex."""
CHANCE = 1e-2
"""Largest probability of the confirmed vertices by chance: true cavities 2.6e-3 or less, others 1.4e-2."""


def judged(
    mesh: OutlineMesh, held_out: Sequence[GreyView], candidate: Found, null: Found, *, least_mean_gain: float
) -> Bool[np.ndarray, " n"]:
    """The vertices of the connected, moved regions that the held-out views confirm.

    `null` is a search where the outlines are certain; what it finds is by chance. `least_mean_gain` is the
    mean rise of the correlation that a region needs.
    """
    per_patch = max(1.0, vertices_per_patch(mesh, held_out))
    placed = candidate.weight > 0
    gain = _gains(mesh, held_out, candidate.surface, candidate.far & placed)
    heights, null_heights = heights_mm(mesh, candidate.surface), heights_mm(mesh, null.surface)
    null_gain = _gains(mesh, held_out, null.surface, null.far & (null.weight > 0))
    kept = np.zeros(len(placed), bool)
    for part in connected_parts(candidate.far, mesh.faces):
        measured = part & placed & np.isfinite(gain)
        if not measured.any():
            continue
        depth = float(np.median(heights[measured]))
        by_chance = ((null_gain > LEAST_GAIN) & (np.abs(null_heights) > 0.5 * abs(depth))).sum()
        p0 = (by_chance / per_patch + 1) / (null.active.sum() / per_patch + 2)
        confirmed = int((gain[measured] > LEAST_GAIN).sum())
        patches = max(int(np.ceil(part.sum() / per_patch)), 1)
        chance = float(bdtrc(int(confirmed / per_patch) - 1, patches, p0))
        rise = float(gain[measured].mean())
        kept |= part & (chance < CHANCE and rise > least_mean_gain)
    return kept


def mean_gain(
    mesh: OutlineMesh,
    views: Sequence[GreyView],
    before: Float[np.ndarray, "n 3"],
    after: Float[np.ndarray, "n 3"],
    zone: Bool[np.ndarray, " n"],
) -> float:
    """Mean rise of the correlation from one surface to another, over the patches of a zone seen on both."""
    rows = np.flatnonzero(zone)
    rise = _risen(patches_of(mesh, before)[rows], patches_of(mesh, after)[rows], views)
    return float(np.nanmean(rise)) if np.isfinite(rise).any() else 0.0


def _gains(
    mesh: OutlineMesh,
    views: Sequence[GreyView],
    surface: Float[np.ndarray, "n 3"],
    where: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Rise of the correlation from the outline surface to another; nan elsewhere and where unknown."""
    gain, rows = np.full(len(surface), np.nan), np.flatnonzero(where)
    if len(rows):
        gain[rows] = _risen(mesh.outline[rows], patches_of(mesh, surface)[rows], views)
    return gain


def _risen(before: Patches, after: Patches, views: Sequence[GreyView]) -> Float[np.ndarray, " n"]:
    """Mean rise of the correlation over the kinds of score known on both surfaces; nan without any."""
    here = np.zeros(1)
    (a, a_enough), (b, b_enough) = agreement(before, views, here), agreement(after, views, here)
    both = (a_enough & b_enough)[..., 0]
    rise = ((b - a)[..., 0] * both).sum(0) / np.maximum(both.sum(0), 1)
    return np.asarray(np.where(both.any(axis=0), rise, np.nan))


COARSE, FINE = 4, 5
"""Ball levels of the first search, and of kept regions: vertices 2 and 1 mm apart on a peach."""
SUPPORT_WEIGHT = 5.0
"""Weight of the pull back to the outline surface where rims support it: five times the best depth's."""
MOST_ROUNDS = 4
"""Most rounds on the finer mesh; later ones move it by under 0.03 mm."""
HELD_SHARE, RIM_RINGS, ZONE_RINGS = 0.2, 2, 3
"""Share of the median support under which a vertex may move; rings around these, and around kept regions."""
LEAST_MEAN_GAIN, LEAST_MEAN_GAIN_LESS_AVERAGED = 0.03, 0.2
"""Mean rise of correlation that a region needs, by averaging. True cavities have 0.07 to 0.55 and 0.44 to
0.55. With less averaging skin without texture has 0.037, a glossy cherry's wrong region 0.099."""
LEAST_AGAIN_GAIN, LEAST_FINE_GAIN = 0.05, 0.02
"""Mean rise of correlation that a finer search needs, over the whole range and near the surface. In the
first, true ones have 0.099 and 0.28, one on reflections 0.034. Second: 0.004 worsens a glossy plum, 0.052 ->
0.060 mm."""


@dataclass(frozen=True, kw_only=True)
class Relief:
    """A surface with its relief, and what is known of it at each vertex.

    `measured`: placed by photos that agree, in a region that held-out views confirm. `bridged`: 1 where the
    outline surface is so flat that outlines may bridge a hollow, 0 where it is round. Where it is high
    without `measured`, the skin may lie deeper than the outlines' error allows. `edge_depth_mm`: depth under
    the outlines of the deepest vertex at the edge of the search, 0 if none is at the edge.
    """

    vertices: Vertices
    measured: Bool[np.ndarray, " n"]
    bridged: Float[np.ndarray, " n"]
    edge_depth_mm: float = 0.0


def relief(
    vertices: Vertices,
    faces: Faces,
    images: Pictures,
    cameras: Sequence[Camera],
    *,
    support: Float[np.ndarray, " n"],
) -> Relief:
    """A surface on `ball`'s directions, moved where photos show that outlines bridge a hollow.

    Only vertices that few rims support (`support`), or on flat surface, may move. At least three views of
    each half must face them. In the first half of the views patches slide along the normal to their highest
    correlation, and a membrane fills between distinct peaks. In the second half a vertex confirms a region if
    its correlation rises by LEAST_GAIN. The same search where rims support a round surface gives the
    probability of that by chance, p0 = (k0 + 1) / (n0 + 2) per patch (Laplace). A region is kept if P(K >= k;
    n, p0) is under CHANCE. Without any, scores are averaged over fewer neighbours once more. Kept regions are
    searched again on a finer mesh, while the held-out views agree better.
    """
    finer = round(np.log(max(len(vertices) - 2, 10) / 10) / np.log(4))
    coarse = outline_mesh(vertices, faces, min(COARSE, finer))
    count = len(coarse.outline.points)
    convex = roundness(coarse.outline.curvature * coarse.radius_mm)
    bridged = np.clip(split(1 - convex[:, None], coarse.level, finer)[:, 0], 0.0, 1.0)
    nothing = Relief(vertices=vertices, measured=np.zeros(len(vertices), bool), bridged=bridged)
    views = grey_views(images, cameras)
    halves = views[::2], views[1::2]
    if len(halves[1]) < FEWEST_VIEWS:
        return nothing
    seen = np.minimum(*(views_facing(coarse.outline, half) for half in halves)) >= FEWEST_VIEWS
    if not seen.any():
        return nothing
    held = support[:count] * convex
    loose = seen & (held < HELD_SHARE * np.median(held[seen]))
    loose = seen & grown(loose, coarse.faces, RIM_RINGS)
    certain = seen & ~grown(loose, coarse.faces, 1) & (convex > 0.9)
    certain &= support[:count] > 0.5 * np.median(support[:count])
    held = SUPPORT_WEIGHT * held
    gentler = (LESS_AVERAGED, LEAST_MEAN_GAIN_LESS_AVERAGED)
    for averaged, least in ((AVERAGED, LEAST_MEAN_GAIN), gentler):
        candidate = searched(coarse, halves[0], loose, held, averaged=averaged)
        if not (candidate.far & (candidate.weight > 0)).any():
            continue
        null = searched(coarse, halves[0], certain, np.zeros(count), averaged=averaged)
        kept = judged(coarse, halves[1], candidate, null, least_mean_gain=least)
        if kept.any():
            break
    else:
        return nothing
    zone = grown(kept, coarse.faces, ZONE_RINGS) & loose & ~(candidate.far & ~kept)
    if (candidate.far & ~zone).any():
        candidate = searched(coarse, halves[0], zone, held, averaged=averaged)
    fine = outline_mesh(vertices, faces, min(FINE, finer))
    again = vertices_per_patch(coarse, views) < 1
    surface, measured = _finer(coarse, fine, candidate, zone, held, halves, again=again)
    return Relief(
        vertices=vertices + split(surface - fine.outline.points, fine.level, finer),
        measured=split(measured[:, None].astype(float), fine.level, finer)[:, 0] > 0.25,
        bridged=bridged,
        edge_depth_mm=float(np.max(-heights_mm(fine, surface)[at_edge(fine, surface)], initial=0.0)),
    )


def _finer(
    coarse: OutlineMesh,
    fine: OutlineMesh,
    candidate: Found,
    zone: Bool[np.ndarray, " n"],
    held: Float[np.ndarray, " n"],
    halves: tuple[Sequence[GreyView], Sequence[GreyView]],
    *,
    again: bool,
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
    """A surface refined on a finer mesh inside a zone while the second half of the views agrees better; and
    where it was measured. `again`: over the whole range first.

    The second half decides up to 3 + MOST_ROUNDS times, so its gain is no unbiased score of the result. It is
    never searched, and each step must raise its mean correlation by LEAST_AGAIN_GAIN or LEAST_FINE_GAIN.
    """

    def spread(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "m k"]:
        return split(values, coarse.level, fine.level)

    surface = fine.outline.points + spread(candidate.surface - coarse.outline.points)
    measured = spread((candidate.weight > 0)[:, None].astype(float))[:, 0] > 0
    zone = spread(zone[:, None].astype(float))[:, 0] > 0.5
    if again:
        other = searched(fine, halves[0], zone, spread(held[:, None])[:, 0], averaged=AVERAGED)
        if mean_gain(fine, halves[1], surface, other.surface, zone) > LEAST_AGAIN_GAIN:
            surface, measured = other.surface, measured | (other.weight > 0)
    for _ in range(MOST_ROUNDS):
        better, placed = refined(fine, surface, halves[0], zone)
        if mean_gain(fine, halves[1], surface, better, zone) < LEAST_FINE_GAIN:
            break
        surface, measured = better, measured | placed
    return surface, measured

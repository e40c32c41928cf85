"""What views that took no part in the search say of relief: each region that moved, kept or refused."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from recon.surface.photo_consistency import GreyView, Patches, agreement
from recon.surface.relief_mesh import OutlineMesh, connected_parts, heights_mm, patches_of, vertices_per_patch
from recon.surface.relief_search import Found

LEAST_GAIN = 0.05
"""Rise of the correlation in the held-out views that confirms a vertex."""
CHANCE = 1e-2
"""How probable as many confirmed vertices may be by chance: true cavities 2.6e-3 or less, others 1.4e-2."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """A patch that the search moved: depth, probability of its confirmed vertices by chance, whether kept."""

    depth_mm: float
    chance: float
    accepted: bool


def judged(
    mesh: OutlineMesh, held_out: Sequence[GreyView], candidate: Found, null: Found, *, least_mean_gain: float
) -> tuple[tuple[Region, ...], Bool[np.ndarray, " n"]]:
    """Each connected region that moved, judged by the views held out, and the vertices of those kept.

    `null` is a search where the outlines are certain: what it finds is there by chance. `least_mean_gain` is
    the mean rise of the correlation that a region must bring.
    """
    per_patch = max(1.0, vertices_per_patch(mesh, held_out))
    placed = candidate.weight > 0
    gain = _gains(mesh, held_out, candidate.surface, candidate.far & placed)
    heights, null_heights = heights_mm(mesh, candidate.surface), heights_mm(mesh, null.surface)
    null_gain = _gains(mesh, held_out, null.surface, null.far & (null.weight > 0))
    regions, kept = [], np.zeros(len(placed), bool)
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
        accepted = chance < CHANCE and rise > least_mean_gain
        regions.append(Region(depth_mm=-float(heights[part].min()), chance=chance, accepted=accepted))
        kept |= part & accepted
    return tuple(regions), kept


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
    """Rise of the correlation, mean over the ways it is measured in on both surfaces; nan where in none."""
    here = np.zeros(1)
    (a, a_enough), (b, b_enough) = agreement(before, views, here), agreement(after, views, here)
    both = (a_enough & b_enough)[..., 0]
    rise = ((b - a)[..., 0] * both).sum(0) / np.maximum(both.sum(0), 1)
    return np.asarray(np.where(both.any(axis=0), rise, np.nan))

"""Map of where the fitted model and the recorded skin differ, each pad's patch from straight above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from reports.patch_residual import PatchResidual
from reports.raycast import TracedSurface, Viewing
from reports.skin_map import MapStyle, SkinLayer, map_picture, side_of

REACH = 1.6
"""Skin farther from every marker than so many distances of neighbours is hatched."""
NEIGHBOURS = 6
"""Markers of which a place's value is the mean, by a Gaussian of one marker's distance: a marker's own noise
does not stand out, a patch's tilt or dome does. Set by hand."""
MOST_SHARE = 0.98
"""The bar reaches what this share of the values stays below."""
LEAST_UM = 20.0
"""The bar's least reach, um: twice a usual gel's noise, which is not to look like misfit. Set by hand."""
VIEW_PX, SAMPLES = 200, 1
"""Pixels of a view, and rays for each of them along a side: with two the map of four
patches takes .5 s of CPU instead of .23, and looks the same."""
MARGIN = 1.35
"""Half of a view over the patch's reach: some skin around it, and room for its name (by eye)."""


def residual_map(
    vertices_mm: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 3"], patches: Sequence[PatchResidual]
) -> bytes | None:
    """PNG of each patch from above, coloured by its residual; None for no patch of two markers."""
    surface = TracedSurface.of(vertices_mm, triangles)
    middle_mm = 0.5 * (vertices_mm.min(axis=0) + vertices_mm.max(axis=0))
    sides, values, seen = [], [], []
    for patch in patches:
        if len(patch.places_mm) < 2:
            continue
        residual_um, near = on_skin(vertices_mm, patch.places_mm, patch.residual_um)
        values.append(residual_um)
        seen.append(near)
        view = _above(patch.places_mm, middle_mm)
        sides.append(
            side_of(
                patch.name, surface, view, near.astype(float), hatched_below=0.5, side_px=VIEW_PX * SAMPLES
            )
        )
    if not sides:
        return None
    limit = _limit_um(values, seen)
    style = MapStyle(
        low="less far in (µm)",
        high="farther in",
        signed=True,
        hatched="no marker of this gel",
        least=limit,
    )
    scores = [np.clip(residual_um, -limit, limit) for residual_um in values]
    return map_picture(sides, scores, style=style, seen=np.zeros(len(vertices_mm), bool), samples=SAMPLES)


def residual_layer(
    vertices_mm: Float[np.ndarray, "n 3"], patches: Sequence[PatchResidual]
) -> SkinLayer | None:
    """The same over the whole skin, the mean where patches overlap; None without a patch of two markers."""
    carried = [
        on_skin(vertices_mm, patch.places_mm, patch.residual_um)
        for patch in patches
        if len(patch.places_mm) >= 2
    ]
    if not carried:
        return None
    values, seen = (np.array(per_vertex) for per_vertex in zip(*carried, strict=True))
    count = seen.sum(axis=0)
    return SkinLayer(
        name="residual",
        values=np.where(seen, values, 0.0).sum(axis=0) / np.maximum(count, 1),
        shown=count > 0,
        limit=_limit_um(values, seen),
        unit="µm",
    )


def _limit_um(
    values: Sequence[Float[np.ndarray, " n"]] | Float[np.ndarray, "g n"],
    seen: Sequence[Bool[np.ndarray, " n"]] | Bool[np.ndarray, "g n"],
) -> float:
    """How far the bar reaches."""
    measured = np.concatenate(
        [np.abs(residual_um[near]) for residual_um, near in zip(values, seen, strict=True)]
    )
    return max(float(np.quantile(measured, MOST_SHARE)) if len(measured) else 0.0, LEAST_UM)


def _above(places_mm: Float[np.ndarray, "k 3"], middle_mm: Float[np.ndarray, " 3"]) -> Viewing:
    """Straight down onto a patch, from outside the fruit."""
    centre = 0.5 * (places_mm.min(axis=0) + places_mm.max(axis=0))
    x, y, z = centre - middle_mm
    half = MARGIN * float(np.linalg.norm(places_mm - centre, axis=1).max())
    return Viewing(
        centre_mm=centre,
        azimuth_deg=float(np.rad2deg(np.arctan2(y, x))),
        elevation_deg=float(np.rad2deg(np.arctan2(z, np.hypot(x, y)))),
        half_width_mm=half,
        half_height_mm=half,
    )


def on_skin(
    vertices_mm: Float[np.ndarray, "n 3"],
    places_mm: Float[np.ndarray, "k 3"],
    values: Float[np.ndarray, " k"],
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The markers' values carried to the vertices, and which vertices are near enough to a marker."""
    tree = cKDTree(places_mm)
    pitch = float(np.median(np.asarray(tree.query(places_mm, k=2)[0])[:, 1]))
    pitch = max(pitch, 1e-6)
    count = min(NEIGHBOURS, len(places_mm))
    away, which = (
        np.asarray(per_neighbour).reshape(len(vertices_mm), count)
        for per_neighbour in tree.query(vertices_mm, k=count)
    )
    weight = np.exp(-0.5 * ((away**2 - away[:, :1] ** 2) / pitch**2))
    return (weight * values[which]).sum(axis=1) / weight.sum(axis=1), away[:, 0] < REACH * pitch

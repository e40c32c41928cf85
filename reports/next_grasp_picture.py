"""Where the pads of the next grasp go: the fruit from six sides, patches filled, those so far outlined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from scipy.spatial import cKDTree

from reports.figures import png_of
from reports.skin_map import INK, MapSide, sides_figure

SKIN = np.array([0.95, 0.90, 0.80])
"""Colour of skin that no pad touches (sRGB shares)."""
SO_FAR = np.array([0.45, 0.47, 0.50])
"""Colour of outlines of what pads have touched so far (sRGB shares)."""
PADS = ("#1d4e89", "#b85c00", "#5a2a66", "#00594f")
"""Fills of the pads' patches, in the order of the pads (sRGB)."""
REACH = 1.3
"""A pixel belongs to a patch within so many marker spacings of a marker: no gaps between markers."""
LEAST_MM, MOST_MM = 0.5, 4.0
"""Bounds of that distance, mm."""


def next_grasp_picture(
    sides: Sequence[MapSide], patches_mm: Mapping[str, Float[np.ndarray, "_p 3"]], *, samples: int = 2
) -> bytes:
    """PNG of the sides in two rows over a key; `sides` with the outlines of what was touched so far.

    `patches_mm`: by pad, points of the skin that it is to touch. `samples` per pixel, as the sides have them.
    """
    images = [_painted(side, patches_mm) for side in sides]
    figure, axes, key = sides_figure(sides, images, samples=samples, key_px=46)
    for of_side, side in zip(axes, sides, strict=True):
        for pad, points in patches_mm.items():
            _named(of_side, side, pad, points)
    _key(key, tuple(patches_mm))
    return png_of(figure)


def _painted(
    side: MapSide, patches_mm: Mapping[str, Float[np.ndarray, "_p 3"]]
) -> Float[np.ndarray, "h w 3"]:
    """One side, RGB of 0 to 1."""
    surface = side.front_surface
    image = np.broadcast_to(SKIN, (*surface.hit.shape, 3)).copy()
    for k, points in enumerate(patches_mm.values()):
        tree = cKDTree(points)
        apart = np.asarray(tree.query(points, k=min(2, len(points)))[0])
        near = float(np.clip(REACH * np.quantile(apart, 0.9), LEAST_MM, MOST_MM))
        inside = np.zeros(surface.hit.shape, dtype=bool)
        inside[surface.hit] = np.asarray(tree.query(surface.points_mm[surface.hit])[0]) < near
        image[inside] = to_rgb(PADS[k % len(PADS)])
    facing = np.clip(surface.normals @ side.view.axes[2], 0.0, 1.0)
    image *= 0.62 + 0.38 * facing[..., None] ** 0.8
    for outline in side.outlines.values():
        image[outline] = SO_FAR
    return np.where(surface.hit[..., None], np.clip(image, 0.0, 1.0), 1.0)


def _named(axes: Axes, side: MapSide, pad: str, points: Float[np.ndarray, "_p 3"]) -> None:
    """The pad's name on its patch, on the sides that it faces."""
    across, up, towards = side.view.axes @ (points.mean(axis=0) - side.view.centre_mm)
    if towards < 0.3 * side.view.half_width_mm:
        return
    how: dict[str, Any] = {"ha": "center", "va": "center", "color": "white", "fontweight": "bold"}
    axes.text(float(across), float(up), pad, fontsize=8, **how)


def _key(axes: Axes, pads: tuple[str, ...]) -> None:
    """What fills and outlines mean."""
    for k, pad in enumerate(pads):
        axes.add_patch(Rectangle((22 * k, 3.5), 3.5, 4, color=PADS[k % len(PADS)]))
        axes.text(22 * k + 4.5, 5.5, f"next: pad {pad}", ha="left", va="center", fontsize=9, color=INK)
    x = 22 * len(pads)
    axes.add_patch(Rectangle((x, 3.5), 3.5, 4, fill=False, edgecolor=tuple(SO_FAR), lw=1.6))
    axes.text(x + 4.5, 5.5, "touched so far", ha="left", va="center", fontsize=9, color=INK)

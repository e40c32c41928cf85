"""Picture of a fruit from two opposite sides: pit seen through the flesh, contact patches painted on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from reports.figures import png_of, show
from reports.raycast import TracedSurface, Viewing, VisibleSurface

FLESH = np.array([0.99, 0.74, 0.47])
"""sRGB shares, ripe flesh as on photos (by eye)."""
PIT = np.array([0.36, 0.20, 0.12])
"""sRGB shares, a stone's brown (by eye)."""
PADS = ((0.114, 0.306, 0.537), (0.0, 0.47, 0.42), (0.48, 0.25, 0.55), (0.35, 0.35, 0.35))
"""sRGB shares of the pads' patches: blue, green, violet, grey, for colour-blind readers too (by eye)."""
_SUN = np.array([-0.45, 0.55, 0.70]) / np.linalg.norm([-0.45, 0.55, 0.70])
"""Where the light comes from: right, up, towards the viewer."""
_HALFWAY = (_SUN + np.array([0.0, 0.0, 1.0])) / np.linalg.norm(_SUN + np.array([0.0, 0.0, 1.0]))
"""Unit vector between light and viewer, for the highlight (Blinn and Phong's shading)."""
_SHADOW_CELLS = 64
"""Cells along a side of the grid of the fruit's shadow, which is soft and interpolated (by eye)."""
_NEIGHBOURS = 12
"""Nearest markers of a pixel that paint a patch on it: a grid's 3 by 3 and three to spare."""


def mesh_picture(
    fruit_vertices: Float[np.ndarray, "n 3"],
    fruit_faces: Int[np.ndarray, "m 3"],
    *,
    pit_vertices: Float[np.ndarray, "k 3"] | None = None,
    pit_faces: Int[np.ndarray, "j 3"] | None = None,
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] | None = None,
    axis_words: tuple[str, str] = ("stem", "suture"),
    view_px: int = 440,
    samples: int = 2,
) -> bytes:
    """PNG of the fruit from two opposite sides, ``2 view_px`` wide; arrays in the fruit frame, mm.

    ``contacts_mm`` holds points where each pad touches (first touches of its markers, say); the skin
    around them, seen in patches, is painted. ``axis_words`` name z and x. ``samples`` squared rays are
    averaged per pixel.
    The pit is blended into the flesh by how deep it lies behind the skin: its place is to be seen, the
    picture does not claim how clear flesh is.
    """
    fruit = TracedSurface.of(fruit_vertices, fruit_faces)
    pit = None
    if pit_vertices is not None and pit_faces is not None and len(pit_faces):
        pit = TracedSurface.of(pit_vertices, pit_faces)
    touched = {pad: fruit.nearest(points) for pad, points in (contacts_mm or {}).items() if len(points)}
    lowest, highest = fruit_vertices.min(axis=0), fruit_vertices.max(axis=0)
    half = 0.72 * float((highest - lowest).max())
    figure = Figure(figsize=(2 * view_px / 100, view_px / 100), dpi=100, facecolor="white")
    for k, azimuth_deg in enumerate((35.0, 215.0)):
        view = Viewing(
            centre_mm=0.5 * (lowest + highest) - np.array([0.0, 0.0, 0.04 * half]),
            azimuth_deg=azimuth_deg,
            elevation_deg=24.0,
            half_width_mm=half,
            half_height_mm=half,
        )
        image = _painted(fruit, pit, touched, view, pixels=view_px * samples, floor_mm=float(lowest[2]))
        axes = figure.add_axes((0.5 * k, 0.0, 0.5, 1.0))
        show(axes, image, half, samples=samples)
        _directions(axes, view, half, axis_words)
        if k == 0:
            _legend(axes, tuple(touched), half, with_pit=pit is not None)
        else:
            _scale_bar(axes, half)
    return png_of(figure)


def _painted(
    fruit: TracedSurface,
    pit: TracedSurface | None,
    touched: Mapping[str, Float[np.ndarray, "_p 3"]],
    view: Viewing,
    *,
    pixels: int,
    floor_mm: float,
) -> Float[np.ndarray, "h w 3"]:
    """The fruit from one side, its pit showing through and the pads' contacts marked, as RGB of 0 to 1."""
    surface = fruit.seen_from(view, width_px=pixels, height_px=pixels)
    image = _ground(fruit, view, pixels=pixels, floor_mm=floor_mm)
    normals = surface.normals[surface.hit]
    facing = np.clip(normals @ view.axes[2], 0.0, 1.0)
    skin = _lit(FLESH, normals, view, gloss=0.16)
    skin = skin * (0.80 + 0.20 * facing[:, None])
    if pit is not None:
        inner = pit.seen_from(view, width_px=pixels, height_px=pixels)
        skin = _through_flesh(skin, surface, inner, facing, view)
    for k, points in enumerate(touched.values()):
        cover = _patch(surface, points)
        mask = cover > 0
        colour = _lit(np.array(PADS[k % len(PADS)]), normals[mask], view, gloss=0.1)
        skin[mask] += 0.78 * cover[mask, None] * (colour - skin[mask])
    image[surface.hit] = np.clip(skin, 0.0, 1.0)
    return image


def _lit(
    colour: Float[np.ndarray, " 3"], normals: Float[np.ndarray, "k 3"], view: Viewing, *, gloss: float
) -> Float[np.ndarray, "k 3"]:
    """Wrapped diffuse light, a paler sky from above and a faint highlight."""
    seen = normals @ view.axes.T
    wrapped = np.clip((seen @ _SUN + 0.45) / 1.45, 0.0, 1.0)
    sky = 0.5 + 0.5 * normals[:, 2]
    highlight = gloss * np.clip(seen @ _HALFWAY, 0.0, 1.0) ** 28
    light = (0.46 + 0.46 * wrapped + 0.16 * sky)[:, None]
    shone = colour ** (1.0 + 0.5 * (1.0 - np.clip(light, 0.0, 1.0))) * light
    return np.asarray(shone + highlight[:, None])


def _through_flesh(
    skin: Float[np.ndarray, "k 3"],
    surface: VisibleSurface,
    inner: VisibleSurface,
    facing: Float[np.ndarray, " k"],
    view: Viewing,
) -> Float[np.ndarray, "k 3"]:
    """The skin's colours, pixel by pixel that shows it, with the pit's blended in where it lies behind."""
    both: Bool[np.ndarray, "h w"] = surface.hit & inner.hit
    if not both.any():
        return skin
    pit_mask = inner.hit[surface.hit]
    deep = np.clip(inner.depth_mm[both] - surface.depth_mm[both], 0.0, None)
    usual = max(float(np.median(deep)), 1e-6)
    clear = 0.62 * np.exp(-0.25 * deep / usual) * (0.45 + 0.55 * facing[pit_mask])
    normals = inner.normals[both]
    stone = _lit(PIT, normals, view, gloss=0.12)
    rim = 1.0 - np.clip(normals @ view.axes[2], 0.0, 1.0)
    stone = stone * (1.0 - 0.35 * rim[:, None] ** 2)
    seen = skin.copy()
    seen[pit_mask] += clear[:, None] * (stone - skin[pit_mask])
    return seen


def _patch(surface: VisibleSurface, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " k"]:
    """How much of each pixel of skin is painted: the density of points there over that of a full grid."""
    shown = surface.points_mm[surface.hit]
    cover = np.zeros(len(shown))
    if not len(points):
        return cover
    tree = cKDTree(points)
    spacing = 1.5
    if len(points) > 1:
        spacing = max(float(np.median(np.asarray(tree.query(points, k=[2])[0]))), 0.2)
    width = 0.8 * spacing
    around = (np.abs(shown - 0.5 * (points.min(axis=0) + points.max(axis=0))) - 4 * width).max(axis=1)
    close = np.flatnonzero(around <= 0.5 * np.ptp(points, axis=0).max())
    near = np.asarray(tree.query(shown[close], k=_NEIGHBOURS, distance_upper_bound=4 * width)[0])
    dense = np.exp(-0.5 * (near / width) ** 2).sum(axis=1)
    within = 2 * np.pi * (width / spacing) ** 2 if len(points) > 3 else 1.0
    cover[close] = np.clip((dense / within - 0.3) / 0.12, 0.0, 1.0)
    return cover


def _ground(
    fruit: TracedSurface, view: Viewing, *, pixels: int, floor_mm: float
) -> Float[np.ndarray, "h w 3"]:
    """White floor with the soft shadow of the fruit, computed on a coarse grid and interpolated."""
    right, up, towards = view.axes
    offsets = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    coarse = (np.arange(_SHADOW_CELLS) + 0.5) / _SHADOW_CELLS * 2 - 1
    plane = (
        view.centre_mm
        + view.half_width_mm * coarse[None, :, None] * right
        - view.half_height_mm * coarse[:, None, None] * up
    )
    along = (plane[..., 2] - floor_mm + 0.05) / towards[2]
    floor = plane - along[..., None] * towards
    dark = fruit.shaded(floor.reshape(-1, 3)).reshape(_SHADOW_CELLS, _SHADOW_CELLS)
    rows = np.stack([np.interp(offsets, coarse, row) for row in dark])
    fine = np.stack([np.interp(offsets, coarse, column) for column in rows.T], axis=1)
    return np.repeat(1.0 - 0.42 * fine[..., None] ** 1.3, 3, axis=2)


def _directions(axes: Axes, view: Viewing, half: float, words_zx: tuple[str, str]) -> None:
    """The z and x axes (stem and suture of a fruit) as two arrows in the lower left corner."""
    foot = np.array([-0.66 * half, -0.80 * half])
    for axis, words in zip(np.eye(3)[[2, 0]], words_zx, strict=True):
        tip = foot + 0.22 * half * (view.axes[:2] @ axis)
        arrow = {"arrowstyle": "-|>", "color": "#16191d", "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", xy=tuple(tip), xytext=tuple(foot), arrowprops=arrow)
        beyond = foot + (tip - foot) * (1 + 0.055 * half / np.linalg.norm(tip - foot))
        above = "bottom" if tip[1] > foot[1] else "top"
        axes.text(
            float(beyond[0]), float(beyond[1]), words, ha="center", va=above, fontsize=12, color="#16191d"
        )


def _scale_bar(axes: Axes, half: float) -> None:
    length = next(step for step in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0) if step <= 0.7 * half)
    end, y = 0.9 * half, -0.88 * half
    axes.plot([end - length, end], [y, y], color="#16191d", lw=2.2, solid_capstyle="butt")
    for x in (end - length, end):
        axes.plot([x, x], [y - 0.018 * half, y + 0.018 * half], color="#16191d", lw=1.2)
    axes.text(end - length / 2, y + 0.03 * half, f"{length:g} mm", ha="center", va="bottom", fontsize=12)


def _legend(axes: Axes, pads: tuple[str, ...], half: float, *, with_pit: bool) -> None:
    items = [(f"pad {pad}", PADS[k % len(PADS)]) for k, pad in enumerate(pads)]
    if with_pit:
        items.append(("pit (expected)", tuple(0.75 * PIT + 0.25 * FLESH)))
    for k, (words, colour) in enumerate(items):
        y = half * (0.91 - 0.105 * k)
        axes.plot([-0.91 * half], [y], marker="o", ms=8, color=colour)
        axes.text(-0.85 * half, y, words, va="center", fontsize=12, color="#16191d")

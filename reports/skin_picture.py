"""Pictures of a fruit from several sides: each vertex of the skin has a colour, touched markers are dots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.tri import Triangulation
from scipy.spatial import ConvexHull, cKDTree

from reports.figures import OUTLINE, outlined, webp_of
from reports.language import decimals
from reports.skin_layer import FLESH, FROM_SIDES, ONE_SIDED, PADS, PIT, SIGNED, middle, ramp, vertex_normals

BLIND_BELOW = 3.0
"""The recordings cannot show a spot whose signal is less than three times its noise."""
INK, GREY = "#16191d", (0.70, 0.72, 0.75)
"""Colours of lines (as the page's text) and of skin without a value."""
FROM_TWO = (("", 35.0, 24.0), ("", 215.0, 24.0))
"""Opposite views without a name: azimuth and elevation (degrees), by eye."""
MARGIN = 1.25
"""Half the width of a view over that of the fruit (by eye)."""
MOST_SHARE, LEAST_MM = 0.98, 0.1
"""The colours of the surface's error end at this quantile of the seen vertices, because a few at the foot
would hide the rest. They reach at least LEAST_MM: a good surface does not look like a bad one."""
WORDS = 0.054
"""Size of the words over the height of the picture of two sides (by eye): 11 px on a phone, which shows the
picture 394 px wide."""
LENGTHS_MM = (50.0, 20.0, 10.0, 5.0, 2.0, 1.0)
"""Lengths of a scale bar, mm."""


@dataclass(frozen=True, kw_only=True)
class MapStyle:
    """Colour bar: values of both signs (`signed`), else from zero up; it reaches at least `least`."""

    signed: bool
    unit: str = ""
    least: float = BLIND_BELOW


def view_axes(azimuth_deg: float, elevation_deg: float) -> Float[np.ndarray, "3 3"]:
    """Unit vectors right, up and towards the viewer; azimuth from +x towards +y, elevation above xy."""
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    flat = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    towards = flat + np.array([0.0, 0.0, np.sin(elevation)])
    return np.stack([right, np.cross(towards, right), towards])


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnSkin:
    """A surface to draw: vertices (mm), triangles, RGB of each vertex, and where each pad touched it."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    colours: Float[np.ndarray, "n 3"]
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]]

    @property
    def middle_mm(self) -> Float[np.ndarray, " 3"]:
        """Centre of its box."""
        return middle(self.vertices)

    @property
    def half_mm(self) -> float:
        """Half the width of a view, mm."""
        return MARGIN * float(np.ptp(self.vertices, axis=0).max()) / 2

    def drawn(self, axes: Axes, view: Float[np.ndarray, "3 3"]) -> None:
        """Draws the side that faces the viewer, in parallel projection, mm."""
        normals = vertex_normals(self.vertices, self.faces)
        across, up, depth = view @ (self.vertices - self.middle_mm).T
        facing = normals @ view[2]
        front = self.faces[facing[self.faces].mean(axis=1) > 0]
        front = front[np.argsort(depth[front].mean(axis=1))]
        light = 0.62 + 0.38 * np.clip(facing, 0.0, 1.0) ** 0.8
        shaded = np.column_stack([self.colours * light[:, None], np.ones(len(light))])
        axes.add_collection(TriMesh(Triangulation(across, up, front), facecolors=shaded))
        nearest = cKDTree(self.vertices)
        for k, points in enumerate(self.contacts_mm.values()):
            seen = points[facing[nearest.query(points)[1]] > 0] if len(points) else points
            across, up = view[:2] @ (seen - self.middle_mm).T
            axes.scatter(across, up, s=4, color=PADS[k % len(PADS)], linewidths=0, zorder=3)
        axes.set(xlim=(-self.half_mm, self.half_mm), ylim=(-self.half_mm, self.half_mm), aspect="equal")
        axes.set_axis_off()


def mesh_picture(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    pit_vertices: Float[np.ndarray, "k 3"] | None = None,
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] | None = None,
    view_px: int = 440,
) -> bytes:
    """WebP of the fruit (fruit frame, mm) from two opposite sides, the outline of its pit over the flesh.

    `contacts_mm`: points where each pad touches. Arrows are z and x; the page around it explains the colours.
    """
    flesh = np.tile(FLESH, (len(vertices), 1))
    skin = DrawnSkin(vertices=vertices, faces=faces, colours=flesh, contacts_mm=contacts_mm or {})
    has_pit = pit_vertices is not None and len(pit_vertices) > 0
    figure = Figure(figsize=(2 * view_px / 100, view_px / 100), dpi=100, facecolor="none")
    half = skin.half_mm
    for k, (_, azimuth_deg, elevation_deg) in enumerate(FROM_TWO):
        view = view_axes(azimuth_deg, elevation_deg)
        axes = figure.add_axes((0.5 * k, 0.0, 0.5, 1.0))
        skin.drawn(axes, view)
        if pit_vertices is not None and has_pit:
            places = (pit_vertices - skin.middle_mm) @ view[:2].T
            outline = places[ConvexHull(places).vertices]
            axes.add_patch(Polygon(outline, facecolor=(*PIT, 0.45), edgecolor=PIT))
        _directions(axes, view, half)
    _scale_bar(figure.axes[1], half)
    return webp_of(outlined(figure))


def map_picture(
    skin: DrawnSkin,
    *,
    limit: float,
    style: MapStyle,
    centre_mm: tuple[float, float, float] | None = None,
    radius_mm: float | None = None,
    view_px: int = 250,
) -> bytes:
    """WebP of six sides, three in a row, over a colour bar; `skin` and `limit` as `coloured` gives them.

    A spot (`centre_mm`, `radius_mm`) is ringed on the sides that it faces. The page around it names the sides
    (FROM_SIDES) and the pads.
    """
    key_px = view_px / 4
    height = 2 * view_px + key_px
    figure = Figure(figsize=(3 * view_px / 100, height / 100), dpi=100, facecolor="none")
    for k, (_, azimuth_deg, elevation_deg) in enumerate(FROM_SIDES):
        row, column = divmod(k, 3)
        place = (column / 3, 1 - (row + 1) * view_px / height, 1 / 3, view_px / height)
        axes, view = figure.add_axes(place), view_axes(azimuth_deg, elevation_deg)
        skin.drawn(axes, view)
        if centre_mm is not None:
            _ring(axes, view @ (np.array(centre_mm) - skin.middle_mm), radius_mm or 3.0, skin.half_mm)
    key = figure.add_axes((0.03, 0.0, 0.94, key_px / height), xlim=(-5, 105), ylim=(0, 1))
    key.set_axis_off()
    _key(key, limit, style, 1.5 * _words_pt(figure.axes[0]))
    return webp_of(outlined(figure))


def coloured(
    vertices_mm: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "m 3"],
    values: Float[np.ndarray, " n"],
    *,
    style: MapStyle,
    seen: Bool[np.ndarray, " n"],
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] | None = None,
) -> tuple[DrawnSkin, float]:
    """The skin coloured by `values`, grey where not `seen`; and the value at the end of the colours."""
    limit = max(float(np.nanmax(np.abs(values[seen if seen.any() else slice(None)]))), style.least)
    shares = np.nan_to_num(values) / limit
    colours = ramp(0.5 + 0.5 * shares, SIGNED) if style.signed else ramp(shares, ONE_SIDED)
    colours[~seen] = GREY
    skin = DrawnSkin(vertices=vertices_mm, faces=triangles, colours=colours, contacts_mm=contacts_mm or {})
    return skin, limit


def surface_sd_map(
    vertices_mm: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "m 3"],
    sd_mm: Float[np.ndarray, " n"],
    *,
    seen: Bool[np.ndarray, " n"],
) -> bytes:
    """WebP of the fruit (fruit frame, mm) coloured by the standard deviation of its surface at each vertex.

    Grey where a vertex was not `seen`; its sd is a guess from the shape around it.
    """
    top = float(np.quantile(sd_mm[seen], MOST_SHARE)) if seen.any() else LEAST_MM
    style = MapStyle(signed=False, unit=" mm", least=LEAST_MM)
    shown, limit = coloured(
        vertices_mm, triangles, np.minimum(sd_mm, max(top, LEAST_MM)), style=style, seen=seen
    )
    return map_picture(shown, limit=limit, style=style, view_px=200)


def _ring(axes: Axes, centre: Float[np.ndarray, " 3"], radius_mm: float, half: float) -> None:
    if centre[2] < 0.3 * half:
        return
    for colour, wide in (("white", 3.6), (INK, 1.6)):
        axes.add_patch(
            Circle(tuple(centre[:2]), radius_mm, fill=False, edgecolor=colour, lw=wide, ls=(0, (4, 2)))
        )


def _key(axes: Axes, limit: float, style: MapStyle, size_pt: float) -> None:
    """Colour bar with the values at its ends and in its middle."""
    bar = ramp(np.linspace(0.0, 1.0, 256), SIGNED if style.signed else ONE_SIDED)
    axes.imshow(bar[None], extent=(0, 100, 0.6, 1.0), aspect="auto")
    ends = (-limit, 0.0, limit) if style.signed else (0.0, limit / 2, limit)
    for k, (value, side) in enumerate(zip(ends, ("left", "center", "right"), strict=True)):
        words = f"{decimals(f'{value:.3g}')}{style.unit}"
        axes.text(50 * k, 0.5, words, ha=side, va="top", fontsize=size_pt, color=INK)


def _words_pt(axes: Axes) -> float:
    return WORDS * 72 * float(axes.get_window_extent().height) / 100


def _directions(axes: Axes, view: Float[np.ndarray, "3 3"], half: float) -> None:
    """The z and x axes (stem and suture of a fruit) as two arrows in the lower left corner; the letter z is
    above its arrow and left of the fruit, x below both.
    """
    foot = np.array([-0.68 * half, -0.74 * half])
    arrow = {"arrowstyle": "<|-", "color": INK, "lw": 1.3, "shrinkA": 0, "shrinkB": 0} | {
        "path_effects": OUTLINE
    }
    for axis, words, way in zip((2, 0), "zx", (1, -1), strict=True):
        tip = foot + 0.17 * half * view[:2, axis]
        axes.annotate("", xy=tuple(foot), xytext=tuple(tip), arrowprops=arrow)
        end = way * max(way * tip[1], way * foot[1]) + way * 0.03 * half
        across, up = ("right", "bottom") if way > 0 else ("center", "top")
        axes.text(tip[0], end, words, ha=across, va=up, fontsize=_words_pt(axes), color=INK)


def _scale_bar(axes: Axes, half: float) -> None:
    length = next((step for step in LENGTHS_MM if step <= 0.7 * half), LENGTHS_MM[-1])
    end, y = 0.9 * half, -0.88 * half
    axes.plot([end - length, end], [y, y], color=INK, lw=2.2, solid_capstyle="butt")
    axes.text(
        end - length / 2,
        y + 0.03 * half,
        f"{length:g} mm",
        ha="center",
        va="bottom",
        fontsize=_words_pt(axes),
    )

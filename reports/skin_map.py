"""Maps on the fruit's skin, seen from six sides: colour is a score, hatching is where nothing can be seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from scipy.spatial import cKDTree

from reports.figures import png_of, show
from reports.raycast import TracedSurface, Viewing, VisibleSurface

BLIND_BELOW = 3.0
"""A spot whose signal is less than three times its noise could not be seen."""
INK, _GREY = "#16191d", np.array([0.70, 0.72, 0.75])
"""Colours of lines (as the page's text) and of hatched skin (sRGB shares)."""
_PAD_LINES = ("#0b2a4f", "#00594f", "#5a2a66", "#333333")
_SIDES = (
    ("suture side", 0.0, 8.0),
    ("right of the suture", 90.0, 8.0),
    ("opposite side", 180.0, 8.0),
    ("left of the suture", 270.0, 8.0),
    ("stem end", 0.0, 86.0),
    ("blossom end", 0.0, -86.0),
)
"""Name, azimuth and elevation (degrees) of the views: four sides a little from above, stem, blossom end."""
SIGNED = LinearSegmentedColormap.from_list(
    "signed", ["#7d0630", "#d1495b", "#f2b9a6", "#f7f3ea", "#a9cbe0", "#3c8dbc", "#163f70"]
)
ONE_SIDED = LinearSegmentedColormap.from_list("one_sided", ["#f7f3ea", "#e8c06a", "#c77a12", "#6b2d00"])


@dataclass(frozen=True, kw_only=True)
class MapStyle:
    """What a map's colours and hatching mean: words at both ends of its bar, and beside the hatched patch.

    `signed`: about zero, else from zero up; the bar reaches `least` at least.
    """

    low: str
    high: str
    signed: bool
    hatched: str
    least: float = BLIND_BELOW


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinLayer:
    """A map about zero over a surface's vertices: its value where `shown`, in the colours of a bar that
    reaches from -`limit` to `limit`; `low` and `high` are the ends of the bar as they are read. `name` is
    the page's word for it among the colours of the fruit in three dimensions.
    """

    name: str
    values: Float[np.ndarray, " n"]
    shown: Bool[np.ndarray, " n"]
    limit: float
    unit: str

    @property
    def low(self) -> str:
        """The bar's lower end with its unit."""
        return f"-{self.high}"

    @property
    def high(self) -> str:
        """The bar's upper end with its unit."""
        return f"{self.limit:.3g} {self.unit}"

    @property
    def colours(self) -> Float[np.ndarray, "n 3"]:
        """RGB of each vertex, 0 to 1."""
        return np.asarray(SIGNED(np.clip(0.5 + 0.5 * self.values / self.limit, 0.0, 1.0)))[:, :3]


@dataclass(frozen=True, kw_only=True, eq=False)
class MapSide:
    """The fruit from one side: what each pixel sees, the blind zone, and each pad's outline."""

    name: str
    view: Viewing
    front_surface: VisibleSurface
    blind: Bool[np.ndarray, "h w"]
    outlines: dict[str, Bool[np.ndarray, "h w"]]


def sides_of(
    vertices_mm: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "m 3"],
    visible: Float[np.ndarray, " n"],
    *,
    hatched_below: float,
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] | None = None,
    view_px: int = 250,
    samples: int = 2,
) -> tuple[MapSide, ...]:
    """The six sides, ready to be coloured by any of the maps; blind where `visible` is below the bound."""
    surface = TracedSurface.of(vertices_mm, triangles)
    lowest, highest = vertices_mm.min(axis=0), vertices_mm.max(axis=0)
    half = 0.62 * float((highest - lowest).max())
    touched = {pad: surface.nearest(points) for pad, points in (contacts_mm or {}).items() if len(points)}
    sides = []
    for name, azimuth_deg, elevation_deg in _SIDES:
        view = Viewing(
            centre_mm=0.5 * (lowest + highest),
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            half_width_mm=half,
            half_height_mm=half,
        )
        sides.append(
            side_of(
                name,
                surface,
                view,
                visible,
                hatched_below=hatched_below,
                touched_mm=touched,
                side_px=view_px * samples,
            )
        )
    return tuple(sides)


def side_of(
    name: str,
    surface: TracedSurface,
    view: Viewing,
    visible: Float[np.ndarray, " n"],
    *,
    hatched_below: float,
    touched_mm: Mapping[str, Float[np.ndarray, "_p 3"]] | None = None,
    side_px: int,
) -> MapSide:
    """One view of a surface, `side_px` wide and high, as `sides_of` makes six of a whole fruit."""
    front_surface = surface.seen_from(view, width_px=side_px, height_px=side_px)
    return MapSide(
        name=name,
        view=view,
        front_surface=front_surface,
        blind=front_surface.hit & (np.nan_to_num(front_surface.of_vertices(visible)) < hatched_below),
        outlines={pad: _outline(front_surface, points) for pad, points in (touched_mm or {}).items()},
    )


def map_picture(
    sides: Sequence[MapSide],
    scores: Float[np.ndarray, " n"] | Sequence[Float[np.ndarray, " n"]],
    *,
    style: MapStyle,
    seen: Bool[np.ndarray, " n"],
    centre_mm: tuple[float, float, float] | None = None,
    radius_mm: float | None = None,
    samples: int = 2,
) -> bytes:
    """PNG of the views, three in a row, over a colour bar; `scores` per vertex, for all views or each.

    A spot (`centre_mm`, `radius_mm`) is ringed on the sides that it faces.
    """
    of_sides = [scores] * len(sides) if isinstance(scores, np.ndarray) else scores
    within = np.abs([values[seen] if seen.any() else values for values in of_sides])
    limit = max(float(np.nanmax(within, initial=0.0)), style.least)
    images = [
        _coloured(side, values, limit=limit, style=style)
        for side, values in zip(sides, of_sides, strict=True)
    ]
    figure, axes, key = sides_figure(sides, images, samples=samples, key_px=74)
    if centre_mm is not None:
        for of_side, side in zip(axes, sides, strict=True):
            _ring(of_side, side, np.asarray(centre_mm), radius_mm or 3.0)
    _key(key, limit, style, tuple(sides[0].outlines))
    return png_of(figure)


def sides_figure(
    sides: Sequence[MapSide], images: Sequence[Float[np.ndarray, "_h _w 3"]], *, samples: int, key_px: int
) -> tuple[Figure, list[Axes], Axes]:
    """The sides by their names, three in a row, over a key so many px high; the sides' axes, and the key's
    (0 to 100 across, 0 to 10 up). `samples` squared pixels of an image make one of the figure.
    """
    view_px, columns = len(images[0]) // samples, 3
    rows = -(-len(sides) // columns)
    height = rows * view_px + key_px
    figure = Figure(figsize=(columns * view_px / 100, height / 100), dpi=100, facecolor="white")
    all_axes = []
    for k, (side, image) in enumerate(zip(sides, images, strict=True)):
        row, column = divmod(k, columns)
        place = (column / columns, 1 - (row + 1) * view_px / height, 1 / columns, view_px / height)
        axes = figure.add_axes(place)
        half = side.view.half_width_mm
        show(axes, image, half, samples=samples)
        axes.text(-0.97 * half, 0.95 * half, side.name, ha="left", va="top", fontsize=9.5, color=INK)
        all_axes.append(axes)
    key = figure.add_axes((0.03, 0.0, 0.94, key_px / height), xlim=(0, 100), ylim=(0, 10))
    key.set_axis_off()
    return figure, all_axes, key


def _coloured(
    side: MapSide, scores: Float[np.ndarray, " n"], *, limit: float, style: MapStyle
) -> Float[np.ndarray, "h w 3"]:
    """One side of the fruit in its scores' colours, blind zones hatched, as RGB of 0 to 1."""
    seen = np.nan_to_num(side.front_surface.of_vertices(scores))
    share = 0.5 + 0.5 * seen / limit if style.signed else seen / limit
    colour = (SIGNED if style.signed else ONE_SIDED)(np.clip(share, 0.0, 1.0))[..., :3]
    rows, columns = np.indices(side.blind.shape)
    stripes = ((rows + columns) // 5 % 3 == 0)[..., None]
    colour = np.where(side.blind[..., None], np.where(stripes, 0.82 * _GREY, _GREY + 0.12), colour)
    facing = np.clip(side.front_surface.normals @ side.view.axes[2], 0.0, 1.0)
    image = colour * (0.62 + 0.38 * facing[..., None] ** 0.8)
    for k, outline in enumerate(side.outlines.values()):
        image = np.where(outline[..., None], to_rgb(_PAD_LINES[k % 4]), image)
    return np.where(side.front_surface.hit[..., None], np.clip(image, 0.0, 1.0), 1.0)


def _outline(front_surface: VisibleSurface, points: Float[np.ndarray, "p 3"]) -> Bool[np.ndarray, "h w"]:
    """The rim of the skin that lies within two thirds of a marker's spacing of a touched place."""
    tree = cKDTree(points)
    spacing = 1.5
    if len(points) > 1:
        apart = np.asarray(tree.query(points, k=[2])[0])
        spacing = float(np.clip(np.quantile(apart, 0.9), 0.4, 2.5))
    inside = np.zeros(front_surface.hit.shape, dtype=bool)
    skin_mm = front_surface.points_mm[front_surface.hit]
    inside[front_surface.hit] = np.isfinite(tree.query(skin_mm, distance_upper_bound=spacing)[0])
    deep = inside.copy()
    for axis in (0, 1):
        for step in (-3, 3):
            deep &= np.roll(inside, step, axis=axis)
    return inside & ~deep


def _ring(axes: Axes, side: MapSide, centre_mm: Float[np.ndarray, " 3"], radius_mm: float) -> None:
    across, up, towards = side.view.axes @ (centre_mm - side.view.centre_mm)
    if towards < 0.3 * side.view.half_width_mm:
        return
    for colour, wide in (("white", 3.6), (INK, 1.6)):
        axes.add_patch(
            Circle(
                (float(across), float(up)), radius_mm, fill=False, edgecolor=colour, lw=wide, ls=(0, (4, 2))
            )
        )


def _key(axes: Axes, limit: float, style: MapStyle, pads: tuple[str, ...]) -> None:
    """Colour bar with words at its ends, the hatching, and the pads' outlines."""
    bar = np.linspace(0, 1, 256)[None]
    cmap = SIGNED if style.signed else ONE_SIDED
    axes.imshow(cmap(bar), extent=(0, 46, 5.6, 8.2), aspect="auto")
    axes.add_patch(Rectangle((0, 5.6), 46, 2.6, fill=False, edgecolor="#8b939e", lw=0.7))
    ends = (-limit, 0.0, limit) if style.signed else (0.0, limit / 2, limit)
    for x, value in zip((0.0, 23.0, 46.0), ends, strict=True):
        axes.text(x, 4.9, f"{value:.3g}", ha="center", va="top", fontsize=8.5, color="#535b66")
    axes.text(0, 2.4, style.low, ha="left", va="top", fontsize=9, color=INK)
    axes.text(46, 2.4, style.high, ha="right", va="top", fontsize=9, color=INK)
    patch: UInt8[np.ndarray, "h w 3"] = np.zeros((14, 24, 3), dtype=np.uint8)
    rows, columns = np.indices(patch.shape[:2])
    dark = ((rows + columns) // 3 % 3 == 0)[..., None]
    patch[:] = np.where(dark, 255 * 0.82 * _GREY, 255 * np.minimum(_GREY + 0.12, 1.0)).astype(np.uint8)
    axes.imshow(patch, extent=(54, 58, 5.6, 8.2), aspect="auto", interpolation="nearest")
    axes.text(59.3, 6.9, style.hatched, ha="left", va="center", fontsize=9, color=INK)
    for k, pad in enumerate(pads):
        x = 54 + 15 * k
        axes.add_patch(Rectangle((x, 1.0), 4, 2.4, fill=False, edgecolor=_PAD_LINES[k % 4], lw=1.6))
        axes.text(x + 5.3, 2.2, f"pad {pad}", ha="left", va="center", fontsize=9, color=INK)

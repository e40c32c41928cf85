"""The background plate: the support plane without the fruit, combined from all views."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from recon.cameras.camera import Camera
from recon.picture_values import Pictures

MOST_VIEWS = 24
"""Most photos for the plate, evenly chosen: more do not improve the median. Set by hand."""
FEWEST_VIEWS = 3
"""Least number of photos that show a cell: two have no robust median."""
SIDE_CELLS = 900
"""Cells along a side, about as fine as the photos show the ground. Set by hand; see ROWS_AT_ONCE."""
DIM = 0.15
"""Quantile over the views for the dim side, 1 - DIM for the bright: excludes one outlier of seven."""
LEAST_GAIN = 0.03
"""Relative brightness difference between photos that is not corrected. Set by hand."""
ROWS_AT_ONCE = 12
"""24 layers of 12 rows of 900 cells in three colours are 780 kB: they stay in a processor's cache."""


@dataclass(frozen=True)
class BackgroundPlate:
    """Colours (BGR) of the plane z = 0 on a square grid about the origin, and where they are known.

    `dim` and `bright` are quantiles over the views (DIM, 1 - DIM). They differ where the ground shines, where
    a shadow moved, and at misregistered edges.
    """

    colours: UInt8[np.ndarray, "s s 3"]
    dim: UInt8[np.ndarray, "s s 3"]
    bright: UInt8[np.ndarray, "s s 3"]
    known: Bool[np.ndarray, "s s"]
    half_width_mm: float


@dataclass(frozen=True)
class GroundViews:
    """The plane z = 0 in some of the photos, on the grid of their plates. `layers[k]` is photo `chosen[k]`;
    `ahead[k]` marks the cells in front of its camera.
    """

    chosen: tuple[int, ...]
    homographies: tuple[Float[np.ndarray, "3 3"], ...]
    sizes_px: tuple[tuple[int, int], ...]
    layers: UInt8[np.ndarray, "v s s 3"]
    ahead: Bool[np.ndarray, "v s s"]
    half_width_mm: float


def ground_views(images: Pictures, cameras: Sequence[Camera], *, half_width_mm: float) -> GroundViews:
    """At most MOST_VIEWS photos, evenly chosen, resampled on the plane. Cameras have no distortion."""
    chosen = np.unique(np.linspace(0, len(images) - 1, min(MOST_VIEWS, len(images))).round().astype(int))
    side = (SIDE_CELLS, SIDE_CELLS)
    layers = np.empty((len(chosen), *side, 3), np.uint8)
    ahead = np.empty((len(chosen), *side), bool)
    cell = np.arange(SIDE_CELLS, dtype=np.float32)
    homographies = []
    for k, i in enumerate(chosen.tolist()):
        H = image_from_plane(cameras[i]) @ plane_from_cell(half_width_mm)
        cv2.warpPerspective(images[i], H, side, dst=layers[k], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        ahead[k] = (H[2, 0] * cell + H[2, 2])[None, :] + (H[2, 1] * cell)[:, None] > 0
        homographies.append(H)
    sizes = tuple((image.shape[1], image.shape[0]) for image in images)
    return GroundViews(
        tuple(chosen.tolist()),
        tuple(homographies),
        tuple(sizes[i] for i in chosen),
        layers,
        ahead,
        half_width_mm,
    )


def background_plate(
    views: GroundViews, covered: Sequence[Bool[np.ndarray, "_ _"]] | None = None
) -> BackgroundPlate:
    """Median and quantiles over the views of each cell's colour, with exposure differences corrected.

    `covered` marks the fruit's pixels in every photo, at any resolution (they do not count); without it the
    median must outvote them. A cell is known if three views see it.
    """
    seen = np.zeros(views.ahead.shape, bool)
    side = (SIDE_CELLS, SIDE_CELLS)
    for k, (i, H, size) in enumerate(zip(views.chosen, views.homographies, views.sizes_px, strict=True)):
        visible = np.full(size[::-1], 255, np.uint8)
        if covered is not None:
            cover = cv2.resize(covered[i].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
            visible[cv2.dilate(cover, np.ones((5, 5), np.uint8)) > 0] = 0
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        seen[k] = views.ahead[k] & (cv2.warpPerspective(visible, H, side, flags=flags) > 250)
    known = seen.sum(0, dtype=np.uint8) >= FEWEST_VIEWS
    some, some_seen = views.layers[:, ::7, ::7], np.ascontiguousarray(seen[:, ::7, ::7])
    middle = _quantiles(some, some_seen, np.ones((len(some), 3)), (0.5,))[0]
    gains = np.ones((len(some), 3))
    for layer in range(len(some)):
        both = some_seen[layer] & known[::7, ::7]
        if both.sum() > 50:
            gains[layer] = np.median((middle[both] + 1.0) / (some[layer][both] + 1.0), axis=0)
    if np.abs(gains - 1).max() <= LEAST_GAIN:
        gains = np.ones_like(gains)
    dim, colours, bright = _quantiles(views.layers, seen, gains, (DIM, 0.5, 1 - DIM))
    return BackgroundPlate(colours, dim, bright, known, views.half_width_mm)


def plane_from_cell(half_width_mm: float) -> Float[np.ndarray, "3 3"]:
    """Matrix from homogeneous grid indices (column, row) to (x, y), mm."""
    step = 2 * half_width_mm / (SIDE_CELLS - 1)
    return np.array([[step, 0, -half_width_mm], [0, step, -half_width_mm], [0, 0, 1.0]])


def background_in_view(
    background: BackgroundPlate,
    camera: Camera,
    layers: Sequence[np.ndarray],
    *,
    corner_px: tuple[int, int],
    size_px: tuple[int, int],
    shrink: int,
) -> tuple[list[np.ndarray], Bool[np.ndarray, "h w"]]:
    """Layers on the plate's grid, warped to a camera's shrunk window, and the mask of the known plate.

    `corner_px` is the window's first pixel (column, row) in the picture, `size_px` its (columns, rows) when
    shrunk.
    """
    offset = (shrink - 1) / 2
    window = np.array(
        [
            [1 / shrink, 0, -(corner_px[0] + offset) / shrink],
            [0, 1 / shrink, -(corner_px[1] + offset) / shrink],
            [0, 0, 1],
        ]
    )
    H = window @ image_from_plane(camera) @ plane_from_cell(background.half_width_mm)
    seen = [np.asarray(cv2.warpPerspective(layer, H, size_px, flags=cv2.INTER_LINEAR)) for layer in layers]
    known = (
        cv2.warpPerspective(background.known.astype(np.uint8) * 255, H, size_px, flags=cv2.INTER_LINEAR) > 250
    )
    ahead = np.linalg.inv(H)[2]
    w = (ahead[0] * np.arange(size_px[0]) + ahead[2])[None, :] + (ahead[1] * np.arange(size_px[1]))[:, None]
    middle = H @ np.array([(SIDE_CELLS - 1) / 2, (SIDE_CELLS - 1) / 2, 1.0])
    return seen, known & (w * np.sign(middle[2]) > 0)


def image_from_plane(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """The homography K [r1 r2 t] from (x, y, 1) on the plane z = 0 to homogeneous pixels."""
    return np.asarray(camera.intrinsics @ camera.cam_from_world[:3][:, [0, 1, 3]])


def _quantiles(
    layers: UInt8[np.ndarray, "v s s 3"],
    seen: Bool[np.ndarray, "v s s"],
    gains: Float[np.ndarray, "v 3"],
    shares: tuple[float, ...],
) -> list[UInt8[np.ndarray, "s s 3"]]:
    """Lower quantiles `shares` over the layers that see a cell, channels times the layers' gains."""
    side = seen.shape[1]
    out = [np.zeros((side, side, 3), np.uint8) for _ in shares]
    last = np.maximum(seen.sum(0, dtype=np.uint8), 1) - 1
    ranks = [np.floor(share * last).astype(int) for share in shares]
    tables = np.clip(np.arange(256)[:, None] * gains[:, None] + 0.5, 0, 255).astype(np.uint8)
    plain = bool((gains == 1).all())
    for first in range(0, side, ROWS_AT_ONCE):
        part = slice(first, first + ROWS_AT_ONCE)
        rows = []
        for layer, visible, table in zip(layers[:, part], seen[:, part], tables, strict=True):
            unseen = cv2.cvtColor(visible.view(np.uint8) - np.uint8(1), cv2.COLOR_GRAY2BGR)  # 255 or (seen) 0
            rows.append(cv2.bitwise_or(layer if plain else cv2.LUT(layer, table[None]), unseen))
        ordered = np.stack(_sorted_layers(rows)).reshape(-1, 3)
        cells = np.arange(len(ordered) // len(layers))
        for picture, rank in zip(out, ranks, strict=True):
            at = rank[part].ravel() * len(cells) + cells
            picture[part] = ordered.take(at, axis=0).reshape(picture[part].shape)
    return out


def _sorted_layers(layers: list[UInt8[np.ndarray, "..."]]) -> list[UInt8[np.ndarray, "..."]]:
    """The layers' values in ascending order, cell by cell (odd-even merge sort, Batcher 1968)."""
    count = len(layers)
    p = 1
    while p < count:
        k = p
        while k >= 1:
            for j in range(k % p, count - k, 2 * k):
                for i in range(j, min(j + k, count - k)):
                    if i // (2 * p) == (i + k) // (2 * p):
                        low = np.minimum(layers[i], layers[i + k])
                        np.maximum(layers[i], layers[i + k], out=layers[i + k])
                        layers[i] = low
            k //= 2
        p *= 2
    return layers

"""The background plate: the support plane without the fruit, put together from all views."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from recon.cameras.camera import Camera

MOST_VIEWS = 24
"""Photos that make the plate, evenly chosen: a median of more tells no more. Set by hand."""
FEWEST_VIEWS = 3
"""Photos that show a cell, at least: a median of two is none."""
SIDE_CELLS = 900
"""Along a side of the plate. Set by hand, about as fine as the photos show the ground; see ROWS_AT_ONCE."""
LEAST_GAIN = 0.03
"""Relative difference of brightness between photos below which they are taken as they are. Set by hand."""
ROWS_AT_ONCE = 12
"""24 layers of 12 rows of 900 cells in three colours are 780 kB: they stay in a processor's cache."""


@dataclass(frozen=True)
class BackgroundPlate:
    """Colours (BGR) of the plane z = 0 on a square grid about the origin, and where they are known."""

    colours: UInt8[np.ndarray, "s s 3"]
    known: Bool[np.ndarray, "s s"]
    half_width_mm: float


def background_plate(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]], cameras: Sequence[Camera], *, half_width_mm: float
) -> BackgroundPlate:
    """Median over at most MOST_VIEWS photos of every cell's colour, each brought to the others' exposure.

    The median must outvote the fruit. A cell is known where three photos show it. Cameras have no distortion.
    """
    chosen = np.unique(np.linspace(0, len(images) - 1, min(MOST_VIEWS, len(images))).round().astype(int))
    side = (SIDE_CELLS, SIDE_CELLS)
    layers = np.empty((len(chosen), *side, 3), np.uint8)
    seen = np.empty((len(chosen), *side), bool)
    cell = np.arange(SIDE_CELLS, dtype=np.float32)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for k, i in enumerate(chosen.tolist()):
        H = image_from_plane(cameras[i]) @ plane_from_cell(half_width_mm)
        cv2.warpPerspective(images[i], H, side, dst=layers[k], flags=flags)
        ahead = (H[2, 0] * cell + H[2, 2])[None, :] + (H[2, 1] * cell)[:, None] > 0
        inside = np.full(images[i].shape[:2], 255, np.uint8)
        seen[k] = ahead & (cv2.warpPerspective(inside, H, side, flags=flags) > 250)
    known = seen.sum(0, dtype=np.uint8) >= FEWEST_VIEWS
    some, some_seen = layers[:, ::7, ::7], np.ascontiguousarray(seen[:, ::7, ::7])
    gains = np.ones((len(some), 3))
    middle = _median(some, some_seen, gains)
    for layer in range(len(some)):
        both = some_seen[layer] & known[::7, ::7]
        if both.sum() > 50:
            gains[layer] = np.median((middle[both] + 1.0) / (some[layer][both] + 1.0), axis=0)
    if np.abs(gains - 1).max() <= LEAST_GAIN:
        gains = np.ones_like(gains)
    return BackgroundPlate(_median(layers, seen, gains), known, half_width_mm)


def plane_from_cell(half_width_mm: float) -> Float[np.ndarray, "3 3"]:
    """Homogeneous grid indices (column, row) to (x, y)."""
    step = 2 * half_width_mm / (SIDE_CELLS - 1)
    return np.array([[step, 0, -half_width_mm], [0, step, -half_width_mm], [0, 0, 1.0]])


def background_in_view(
    background: BackgroundPlate,
    camera: Camera,
    *,
    corner_px: tuple[int, int],
    size_px: tuple[int, int],
    shrink: int,
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The plate's colours as a camera sees them, and where the plate is known, in a shrunk window.

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
    seen = np.asarray(cv2.warpPerspective(background.colours, H, size_px, flags=cv2.INTER_LINEAR), np.uint8)
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


def _median(
    layers: UInt8[np.ndarray, "v s s 3"], seen: Bool[np.ndarray, "v s s"], gains: Float[np.ndarray, "v 3"]
) -> UInt8[np.ndarray, "s s 3"]:
    """The lower middle of the layers that see a cell, channel by channel, each times its gain."""
    out = np.zeros(layers.shape[1:], np.uint8)
    rank = np.floor(0.5 * (np.maximum(seen.sum(0, dtype=np.uint8), 1) - 1.0)).astype(int)
    tables = np.clip(np.arange(256)[:, None] * gains[:, None] + 0.5, 0, 255).astype(np.uint8)
    for first in range(0, len(out), ROWS_AT_ONCE):
        part = slice(first, first + ROWS_AT_ONCE)
        rows = np.stack([cv2.LUT(layer, t[None]) for layer, t in zip(layers[:, part], tables, strict=True)])
        rows[~seen[:, part]] = 255
        rows.sort(axis=0)
        out[part] = np.take_along_axis(rows, rank[None, part, :, None], axis=0)[0]
    return out

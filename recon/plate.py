"""The clean plate: the support plane without the fruit, put together from all views, since each sees another
part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from recon.camera import Camera

MOST_VIEWS = 24
FEWEST_VIEWS = 3
SIDE_CELLS = 900


@dataclass(frozen=True)
class Plate:
    """Colours (BGR) of the plane z = 0 on a square grid about the origin, and where they are known."""

    colours: UInt8[np.ndarray, "s s 3"]
    known: Bool[np.ndarray, "s s"]
    half_width_mm: float

    @property
    def plane_from_cell(self) -> Float[np.ndarray, "3 3"]:
        """Homogeneous grid indices (column, row) to (x, y)."""
        step = 2 * self.half_width_mm / (len(self.known) - 1)
        return np.array([[step, 0, -self.half_width_mm], [0, step, -self.half_width_mm], [0, 0, 1.0]])


def clean_plate(
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    *,
    half_width_mm: float,
    covered: Sequence[Bool[np.ndarray, "h w"]] | None = None,
) -> Plate:
    """Median over the views of every cell's colour, each view brought to the others' exposure first.

    `covered` marks the fruit's pixels (they do not count); without it the median must outvote them. Cameras
    have no distortion. A cell is known where three views see it.
    """
    grid = Plate(
        np.empty((SIDE_CELLS, SIDE_CELLS, 3), np.uint8),
        np.empty((SIDE_CELLS, SIDE_CELLS), bool),
        half_width_mm,
    )
    chosen = np.unique(np.linspace(0, len(images) - 1, min(MOST_VIEWS, len(images))).round().astype(int))
    stack = np.zeros((len(chosen), SIDE_CELLS, SIDE_CELLS, 3), np.uint8)
    seen = np.zeros((len(chosen), SIDE_CELLS, SIDE_CELLS), bool)
    for layer, i in enumerate(chosen.tolist()):
        H = image_from_plane(cameras[i]) @ grid.plane_from_cell
        sight = np.full(images[i].shape[:2], 255, np.uint8)
        if covered is not None:
            sight[cv2.dilate(covered[i].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = 0
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        stack[layer] = cv2.warpPerspective(images[i], H, (SIDE_CELLS, SIDE_CELLS), flags=flags)
        seen[layer] = cv2.warpPerspective(sight, H, (SIDE_CELLS, SIDE_CELLS), flags=flags) > 250
        rows, columns = np.mgrid[:SIDE_CELLS, :SIDE_CELLS]
        seen[layer] &= H[2, 0] * columns + H[2, 1] * rows + H[2, 2] > 0
    seen_by = seen.sum(0)
    known = seen_by >= FEWEST_VIEWS
    colours = _median(stack, seen)
    gains = np.ones((len(chosen), 3))
    for layer in range(len(chosen)):
        both = (seen[layer] & known)[::7, ::7]
        if both.sum() > 50:
            ratio = (colours[::7, ::7][both] + 1.0) / (stack[layer][::7, ::7][both] + 1.0)
            gains[layer] = np.median(ratio, axis=0)
    if np.abs(gains - 1).max() > 0.03:
        for layer, gain in enumerate(gains):
            stack[layer] = np.clip(stack[layer] * gain + 0.5, 0, 255)
        colours = _median(stack, seen)
    return Plate(colours, known, half_width_mm)


def plate_seen_by(
    plate: Plate, camera: Camera, *, corner_px: tuple[int, int], size_px: tuple[int, int], shrink: int
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The plate as a camera would see it, and where it is known, in a window shrunk `shrink` times.

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
    H = window @ image_from_plane(camera) @ plate.plane_from_cell
    colours = cv2.warpPerspective(plate.colours, H, size_px, flags=cv2.INTER_LINEAR)
    known = cv2.warpPerspective(plate.known.astype(np.uint8) * 255, H, size_px, flags=cv2.INTER_LINEAR) > 250
    ahead = np.linalg.inv(H)
    columns, rows = np.meshgrid(np.arange(size_px[0]), np.arange(size_px[1]))
    w = ahead[2, 0] * columns + ahead[2, 1] * rows + ahead[2, 2]
    middle = H @ np.array([(SIDE_CELLS - 1) / 2, (SIDE_CELLS - 1) / 2, 1.0])
    return np.asarray(colours, np.uint8), known & (w * np.sign(middle[2]) > 0)


def image_from_plane(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """The homography K [r1 r2 t] from (x, y, 1) on the plane z = 0 to homogeneous pixels."""
    return np.asarray(camera.intrinsics @ camera.cam_from_world[:3][:, [0, 1, 3]])


def _median(
    stack: UInt8[np.ndarray, "v s s 3"], seen: Bool[np.ndarray, "v s s"]
) -> UInt8[np.ndarray, "s s 3"]:
    """Median over the layers that see a cell (the lower of two middles)."""
    layers, side = seen.shape[:2]
    out = np.zeros((side, side, 3), np.uint8)
    rank = np.maximum(seen.sum(0) - 1, 0) // 2
    for row in range(0, side, 100):
        part = slice(row, row + 100)
        for channel in range(3):
            values = np.where(seen[:, part], stack[:, part, :, channel], 255).reshape(layers, -1)
            ordered = np.sort(np.ascontiguousarray(values.T), axis=1)
            picked = np.take_along_axis(ordered, rank[part].reshape(-1, 1), 1)
            out[part, :, channel] = picked.reshape(out[part].shape[:2])
    return out

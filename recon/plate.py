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
DIM = 0.15


@dataclass(frozen=True)
class Plate:
    """Colours (BGR) of the plane z = 0 on a square grid about the origin, and where they are known.

    `dim` and `bright` are quantiles over the views (DIM, 1 - DIM): they part where the ground shines, where a
    shadow moved, and at edges that are not quite registered.
    """

    colours: UInt8[np.ndarray, "s s 3"]
    dim: UInt8[np.ndarray, "s s 3"]
    bright: UInt8[np.ndarray, "s s 3"]
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
    """Median (and spread) over the views of every cell's colour, each view brought to the others' exposure.

    `covered` marks the fruit's pixels (they do not count); without it the median must outvote them. Cameras
    have no distortion. A cell is known where three views see it.
    """
    empty = np.empty((SIDE_CELLS, SIDE_CELLS, 3), np.uint8)
    grid = Plate(empty, empty, empty, np.empty((SIDE_CELLS, SIDE_CELLS), bool), half_width_mm)
    chosen = np.unique(np.linspace(0, len(images) - 1, min(MOST_VIEWS, len(images))).round().astype(int))
    stack = np.zeros((len(chosen), SIDE_CELLS, SIDE_CELLS, 3), np.uint8)
    seen = np.zeros((len(chosen), SIDE_CELLS, SIDE_CELLS), bool)
    cell = np.arange(SIDE_CELLS, dtype=np.float32)
    for layer, i in enumerate(chosen.tolist()):
        H = image_from_plane(cameras[i]) @ grid.plane_from_cell
        sight = np.full(images[i].shape[:2], 255, np.uint8)
        if covered is not None:
            sight[cv2.dilate(covered[i].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0] = 0
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        stack[layer] = cv2.warpPerspective(images[i], H, (SIDE_CELLS, SIDE_CELLS), flags=flags)
        seen[layer] = cv2.warpPerspective(sight, H, (SIDE_CELLS, SIDE_CELLS), flags=flags) > 250
        seen[layer] &= H[2, 0] * cell[None, :] + H[2, 1] * cell[:, None] + H[2, 2] > 0
    seen_by = seen.sum(0)
    known = seen_by >= FEWEST_VIEWS
    some, some_seen = np.ascontiguousarray(stack[:, ::7, ::7]), seen[:, ::7, ::7]
    middle = _quantiles(some, some_seen, (0.5,))[0]
    gains = np.ones((len(chosen), 3))
    for layer in range(len(chosen)):
        both = some_seen[layer] & known[::7, ::7]
        if both.sum() > 50:
            ratio = (middle[both] + 1.0) / (some[layer][both] + 1.0)
            gains[layer] = np.median(ratio, axis=0)
    if np.abs(gains - 1).max() > 0.03:
        levels = np.arange(256)[:, None]
        for layer, gain in enumerate(gains):
            table = np.clip(levels * gain + 0.5, 0, 255).astype(np.uint8)
            stack[layer] = cv2.LUT(stack[layer], table[None])
    dim, colours, bright = _quantiles(stack, seen, (DIM, 0.5, 1 - DIM))
    return Plate(colours, dim, bright, known, half_width_mm)


def plate_seen_by(
    plate: Plate, camera: Camera, *, corner_px: tuple[int, int], size_px: tuple[int, int], shrink: int
) -> tuple[list[UInt8[np.ndarray, "h w 3"]], Bool[np.ndarray, "h w"]]:
    """The plate (its median, dim and bright colours) as a camera would see it, and where it is known, in a
    window shrunk `shrink` times.

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
    layers = [
        np.asarray(cv2.warpPerspective(layer, H, size_px, flags=cv2.INTER_LINEAR), np.uint8)
        for layer in (plate.colours, plate.dim, plate.bright)
    ]
    known = cv2.warpPerspective(plate.known.astype(np.uint8) * 255, H, size_px, flags=cv2.INTER_LINEAR) > 250
    ahead = np.linalg.inv(H)
    columns, rows = np.meshgrid(np.arange(size_px[0]), np.arange(size_px[1]))
    w = ahead[2, 0] * columns + ahead[2, 1] * rows + ahead[2, 2]
    middle = H @ np.array([(SIDE_CELLS - 1) / 2, (SIDE_CELLS - 1) / 2, 1.0])
    return layers, known & (w * np.sign(middle[2]) > 0)


def image_from_plane(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """The homography K [r1 r2 t] from (x, y, 1) on the plane z = 0 to homogeneous pixels."""
    return np.asarray(camera.intrinsics @ camera.cam_from_world[:3][:, [0, 1, 3]])


def _quantiles(
    stack: UInt8[np.ndarray, "v s s 3"], seen: Bool[np.ndarray, "v s s"], shares: tuple[float, ...]
) -> list[UInt8[np.ndarray, "s s 3"]]:
    """Order statistics over the layers that see a cell (of an even number the lower middle)."""
    layers, side = seen.shape[:2]
    out = [np.zeros((side, side, 3), np.uint8) for _ in shares]
    last = np.maximum(seen.sum(0) - 1, 0)
    ranks = [np.floor(share * last).astype(int) for share in shares]
    for row in range(0, side, 100):
        part = slice(row, row + 100)
        for channel in range(3):
            values = np.where(seen[:, part], stack[:, part, :, channel], 255).reshape(layers, -1)
            ordered = np.sort(np.ascontiguousarray(values.T), axis=1)
            for picture, rank in zip(out, ranks, strict=True):
                picked = np.take_along_axis(ordered, rank[part].reshape(-1, 1), 1)
                picture[part, :, channel] = picked.reshape(picture[part].shape[:2])
    return out

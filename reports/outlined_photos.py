"""Photos of a fruit with the outlines from which drupe made its mesh: one photo, or a sheet of all."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from reports.photo import PAGE_PX, jpeg, within

LINE_BGR, INK_BGR = (255, 190, 0), (29, 25, 22)
"""Line: a light blue that no stone fruit has, on paper and in shadow too; names: the page's text colour."""
TILE_PX, MARGIN = 220, 0.18
"""Side of a photo on the sheet (px), and margin around the outline over its size. Set by hand: a reader can
judge outlines to a pixel of the screen, and 24 photos take 250 kB."""
NAME_PX, COLUMNS = 20, 6
"""Height of the line with a photo's name, px, and photos per row: 1320 px, a screen's width."""
NAME_LETTERS = 28
"""Letters of a name that fit under a photo at the size used."""
BLUR = 0.45
"""Standard deviation of the blur before a photo is shrunk, in sheet pixels: it acts as an area mean."""
LINE_PX = 1
"""Width of the line in the finished picture, px: a wider one would hide the edge of the fruit."""
_SUBPIXEL_BITS = 4
"""Fractional bits of the coordinates that OpenCV draws: sixteenths of a pixel."""


class OutlinedPhoto(NamedTuple):
    """An undistorted BGR photo, and the closed outline in its pixels (column, row)."""

    name: str
    image: UInt8[np.ndarray, "_h _w 3"]
    outline_px: Float[np.ndarray, "_n 2"]


def outlined_photo_jpeg(photo: OutlinedPhoto, *, longest_px: int = PAGE_PX) -> bytes:
    """JPEG of the whole photo with its outline, its longer side at most `longest_px`."""
    image, scale = within(photo.image, longest_px)
    return jpeg(_drawn(image, (photo.outline_px + 0.5) * scale - 0.5))


def outline_sheet_jpeg(photos: Sequence[OutlinedPhoto]) -> bytes:
    """JPEG of all photos, each cut out around its outline, named, COLUMNS in a row.

    Raises ValueError without photos.
    """
    if not photos:
        raise ValueError("A sheet of outlines needs at least one photo.")
    columns = min(COLUMNS, len(photos))
    rows = -(-len(photos) // columns)
    sheet = np.full((rows * (TILE_PX + NAME_PX), columns * TILE_PX, 3), 255, np.uint8)
    for k, photo in enumerate(photos):
        top, left = k // columns * (TILE_PX + NAME_PX), k % columns * TILE_PX
        sheet[top : top + TILE_PX, left : left + TILE_PX] = _tile(photo)
        place = (left + 6, top + TILE_PX + NAME_PX - 6)
        cv2.putText(sheet, _plain(photo.name), place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, INK_BGR, 1, cv2.LINE_AA)
    return jpeg(sheet)


def _tile(photo: OutlinedPhoto) -> UInt8[np.ndarray, "_t _t 3"]:
    """The square around the outline, TILE_PX high; its area outside the photo is white."""
    low, high = photo.outline_px.min(axis=0), photo.outline_px.max(axis=0)
    side = max(float((high - low).max()) * (1 + 2 * MARGIN), 1.0)
    corner, scale = (low + high) / 2 - side / 2, TILE_PX / side
    first = np.maximum(np.floor(corner).astype(int), 0)
    last = np.minimum(np.ceil(corner + side).astype(int) + 1, photo.image.shape[1::-1])
    part = photo.image[first[1] : last[1], first[0] : last[0]]
    if scale < 1:  # an affine map skips pixels
        part = cv2.GaussianBlur(part, (0, 0), BLUR / scale)
    shift = (first + 0.5 - corner) * scale - 0.5
    into_tile = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    tile = cv2.warpAffine(part, into_tile, (TILE_PX, TILE_PX), borderValue=(255, 255, 255))
    return _drawn(np.asarray(tile, np.uint8), (photo.outline_px - first) * scale + shift)


def _drawn(image: UInt8[np.ndarray, "h w 3"], curve: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, "h w 3"]:
    """A copy of the picture with the closed curve."""
    drawn = image.copy()
    points = [np.round(curve * 2**_SUBPIXEL_BITS).astype(np.int32)]
    cv2.polylines(
        drawn, points, isClosed=True, color=LINE_BGR, thickness=LINE_PX, lineType=cv2.LINE_AA,
        shift=_SUBPIXEL_BITS,
    )  # fmt: skip
    return drawn


def _plain(name: str) -> str:
    """A name in ASCII letters, because OpenCV draws no others; a long name loses its middle."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    shown = "".join(character if character.isprintable() else "?" for character in ascii_name)
    half = NAME_LETTERS // 2 - 1
    return shown if len(shown) <= NAME_LETTERS else f"{shown[:half]}..{shown[-half:]}"

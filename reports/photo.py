"""Photos made small enough for a report, as JPEG."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

PAGE_PX, PAGE_QUALITY = 420, 65
"""Longer side of a photo in a page, and JPEG's quality there (0 to 100): about 12 kB."""


def thumbnail_jpeg(image: UInt8[np.ndarray, "h w 3"], *, longest_px: int = PAGE_PX) -> bytes:
    """JPEG of a BGR photo, its longer side at most ``longest_px``; smaller photos keep their size."""
    return jpeg(within(image, longest_px)[0], quality=PAGE_QUALITY)


def within(image: UInt8[np.ndarray, "h w 3"], longest_px: int) -> tuple[UInt8[np.ndarray, "_h _w 3"], float]:
    """The picture with its longer side at most ``longest_px``, and its scale factor."""
    scale = longest_px / max(image.shape[:2])
    if scale >= 1.0:
        return image, 1.0
    size = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), scale


def jpeg(image: UInt8[np.ndarray, "h w 3"], *, quality: int = 82) -> bytes:
    """A BGR picture as JPEG. Raises ValueError for too many pixels for the format, cv2.error for none."""
    done, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"An image of shape {image.shape} cannot be written as JPEG.")
    return coded.tobytes()

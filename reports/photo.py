"""Photos and pictures made small enough for a report: JPEG files, and WebP within so many bytes of a page."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

_QUALITIES = (80, 65, 50)
"""WebP's quality, 0 to 100, best first: below 50 edges of patches and hatching smear (by eye)."""
_SHRINK = 0.8
"""Factor of the sides from one try to the next: 0.64 of the pixels, and about that of the bytes."""
_LEAST_PX = 48
"""The longer side of the smallest picture that is tried."""


def thumbnail_jpeg(image: UInt8[np.ndarray, "h w 3"], *, longest_px: int = 560, quality: int = 82) -> bytes:
    """JPEG of a BGR photo, its longer side at most ``longest_px``; smaller photos keep their size.

    A report of sixty fruits stays below ten megabytes of photos with the sizes given here.
    """
    return jpeg(within(image, longest_px)[0], quality=quality)


def within(image: UInt8[np.ndarray, "h w 3"], longest_px: int) -> tuple[UInt8[np.ndarray, "_h _w 3"], float]:
    """The picture with its longer side at most ``longest_px``, and the factor by which it was scaled."""
    scale = longest_px / max(image.shape[:2])
    if scale >= 1.0:
        return image, 1.0
    size = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), scale


def jpeg(image: UInt8[np.ndarray, "h w 3"], *, quality: int = 82) -> bytes:
    """A BGR picture as JPEG. Raises ValueError for one that has no pixels or too many for the format."""
    done, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"An image of shape {image.shape} cannot be written as JPEG.")
    return coded.tobytes()


def webp_within(coded: bytes, *, most_bytes: int, longest_px: int) -> bytes:
    """The picture (PNG, JPEG, WebP) as WebP of at most so many bytes, its longer side at most `longest_px`.

    Quality goes down first, then size; a picture is never made larger. Empty where the bytes are no picture,
    or none of at most `most_bytes` can be made of it.
    """
    image = _decoded(coded)
    while image is not None:
        image, _ = within(image, longest_px)
        for quality in _QUALITIES:
            done, made = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])
            if done and made.size <= most_bytes:
                return made.tobytes()
        longest_px = int(_SHRINK * max(image.shape[:2]))
        if longest_px < _LEAST_PX:
            return b""
    return b""


def _decoded(coded: bytes) -> UInt8[np.ndarray, "h w 3"] | None:
    """The picture as BGR; None where it cannot be read."""
    if not coded:
        return None
    try:
        image = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, np.uint8)

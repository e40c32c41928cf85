"""Pictures made small enough to stand in a page: WebP within so many bytes."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from reports.photo import within

_QUALITIES = (80, 65, 50)
"""WebP's quality, 0 to 100, best first: below 50 edges of patches and hatching smear (by eye)."""
_SHRINK = 0.8
"""Factor of the sides from one try to the next: 0.64 of the pixels, and about that of the bytes."""
_LEAST_PX = 48
"""The longer side of the smallest picture that is tried."""


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

"""What the tags of all photos together tell of mat, lens and light; and photos brought to one brightness."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.cameras.photos import Photo
from recon.cameras.printed_mat import Mat
from recon.cameras.tag_optics import TagOptics
from recon.wording import listed

LEAST_WHITE = 90.0
"""Grey levels of 255 of the paper, below which a photo is too dark. Set by hand."""
MOST_UNEVEN = 0.12
"""Relative difference of the paper's white between photos that is left as it is. Set by hand."""
MOST_FALL_OFF = 0.4
"""Share of its light that a lens may lose towards the corners unsaid. Set by hand."""
LEAST_MAT_SEEN = 0.75
"""Share of the mat's tags that all photos together show unless some are covered or cut off. Set by hand."""


def mat_doubts(tags: Sequence[Sequence[int]], mat: Mat) -> list[str]:
    """A sentence where over a quarter of the mat's tags are in no photo; `tags` are those seen in each."""
    seen = {tag for each in tags for tag in each}
    if not seen or len(seen) >= LEAST_MAT_SEEN * len(mat.corners_mm):
        return []
    missing = [str(t) for t in mat.corners_mm if t not in seen]
    return [
        f"{len(missing)} of the mat's {len(mat.corners_mm)} tags are in no photo (tags "
        f"{listed(missing)}): clear the mat, or check that mat.json belongs to the printed mat."
    ]


def lens_doubts(optics: Sequence[TagOptics]) -> list[str]:
    """A sentence where paper gets darker by over 40 % from the middle of the pictures to their corners."""
    if not optics:
        return []
    radius2 = np.concatenate([o.radius2 for o in optics])
    share = np.concatenate([o.whites / o.white for o in optics])
    slope, start = np.polyfit(radius2, share, 1)
    fall = -slope / start
    if fall <= MOST_FALL_OFF:
        return []
    return [
        f"The photos darken by {100 * fall:.0f} % towards their corners, which makes outlines less "
        "certain there. Use a smaller aperture, or remove the lens hood or filter."
    ]


def evened(photos: Sequence[Photo], optics: Sequence[TagOptics]) -> tuple[Photo, ...]:
    """All photos with the paper as white as in the middle one, where they differ by over 12 % or are dark."""
    whites = np.array([o.white for o in optics])
    if len(whites) < len(photos) or len(whites) == 0:
        return tuple(photos)
    goal = max(float(np.median(whites)), 1.7 * LEAST_WHITE)
    gains = goal / whites
    if np.abs(gains - 1).max() <= MOST_UNEVEN:
        return tuple(photos)
    return tuple(
        replace(photo, image=_brightened(photo.image, float(gain)))
        for photo, gain in zip(photos, gains, strict=True)
    )


def _brightened(image: UInt8[np.ndarray, "h w 3"], gain: float) -> UInt8[np.ndarray, "h w 3"]:
    levels: Float[np.ndarray, 256] = np.clip(np.arange(256) * gain + 0.5, 0, 255)
    return np.asarray(cv2.LUT(image, levels.astype(np.uint8)), np.uint8)

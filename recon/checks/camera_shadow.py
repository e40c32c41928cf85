"""A shadow that goes with the camera, as a flash throws it: on one side of every photo's rim. Skin that a
mesh misses is on another side in each photo; what reaches further on one side in all is not the fruit's.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.checks.ground_check import RimEvidence

HEIGHTS_DEG = (-75.0, -45.0, -15.0, 15.0)
"""Bounds of the rim's bands, above the horizontal: shadows lie low; straight below has no left or right."""
FEWEST_SAMPLES = 30
"""Samples of each side of a band, at least: a photo has 8 of its 96 there, so four photos suffice."""
NOTICED_PX = 0.5
"""Left against right that counts, px of the photo as checked: 0.3 at most without a flash, 1.5 with one."""


def left_right_px(evidence: RimEvidence) -> Float[np.ndarray, " b"]:
    """By how much the edge lies further out left than right, px, band by band: medians over all photos.

    The known samples of a band's two sides are compared; 0 where either has fewer than FEWEST_SAMPLES.
    """
    right = np.cos(evidence.turn) > 0
    offset_px = evidence.offset_mm / evidence.pixel_mm
    band = _band(evidence)
    apart = np.zeros(len(HEIGHTS_DEG) - 1)
    for k in range(len(apart)):
        here = evidence.known & (band == k)
        sides = offset_px[here & ~right], offset_px[here & right]
        if min(map(len, sides)) >= FEWEST_SAMPLES:
            apart[k] = np.median(sides[0]) - np.median(sides[1])
    return apart


def in_camera_shadow(evidence: RimEvidence) -> Bool[np.ndarray, " k"]:
    """Samples whose edge may be the shadow's: a differing band's further side, and all below the bands."""
    apart = left_right_px(evidence)
    noticed = np.where(np.abs(apart) > NOTICED_PX, np.sign(apart), 0.0)
    by_band = np.concatenate([noticed, [0.0, 0.0]])  # above the bands, and below them (band -1)
    band = _band(evidence)
    left = np.where(np.cos(evidence.turn) > 0, -1.0, 1.0)
    return np.asarray((by_band[band] * left > 0) | ((band == -1) & noticed.any()))


def camera_shadow_px(evidence: RimEvidence) -> float:
    """By how much left and right differ most, px (positive: left is further out); 0 where they do not."""
    apart = left_right_px(evidence)
    worst = float(apart[np.abs(apart).argmax()])
    return worst if abs(worst) > NOTICED_PX else 0.0


def shadow_sd_mm(evidence: RimEvidence) -> Float[np.ndarray, " k"]:
    """What a shadow that the mesh may have swallowed makes uncertain at each sample, mm.

    In every band that differs, and below the bands, as much as left and right differ where that is most.
    """
    worst_px = abs(camera_shadow_px(evidence))
    noticed = np.abs(left_right_px(evidence)) > NOTICED_PX
    by_band = np.concatenate([noticed, [False, noticed.any()]])
    return np.asarray(worst_px * by_band[_band(evidence)] * evidence.pixel_mm)


def _band(evidence: RimEvidence) -> Int[np.ndarray, " k"]:
    """The band of each sample; -1 below the lowest, the number of bands above the highest."""
    height_deg = np.degrees(np.arcsin(np.clip(np.sin(evidence.turn), -1, 1)))
    return np.asarray(np.searchsorted(HEIGHTS_DEG, height_deg, side="right") - 1)

"""A shadow that goes with the camera, as a flash beside the lens throws it: on one side of every photo's rim.

Skin that a mesh misses is on the left of the fruit in one photo and on its right in another. What reaches
further on one side in all photos is not the fruit's.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from recon.ground_check import RimEvidence

HEIGHTS_DEG = (-75.0, -45.0, -15.0, 15.0)
"""Bounds of the bands of the rim that are compared, by direction above the horizontal: shadows lie low, and
straight below there is no left and right."""
FEWEST_SAMPLES = 30
"""Samples that each side of a band must have: an eighth of a photo's band times 24 photos has 190."""
NOTICED_PX = 0.5
"""Left against right from which on it counts, px of the photo as checked. On the sets that it was chosen on
0.3 at most without a flash, 1.5 and 2.4 with one: benchmarks/photo_evidence.py, "left-right"."""


def left_right_px(evidence: RimEvidence) -> Float[np.ndarray, " b"]:
    """By how much the edge lies further out left than right, px, band by band: medians over all photos.

    The known samples of a band's two sides are compared; 0 where either has fewer than FEWEST_SAMPLES.
    """
    e = evidence
    right = np.cos(e.turn) > 0
    height_deg = np.degrees(np.arcsin(np.clip(np.sin(e.turn), -1, 1)))
    offset_px = e.offset_mm / e.pixel_mm
    out = []
    for low, high in pairwise(HEIGHTS_DEG):
        band = e.known & (height_deg >= low) & (height_deg < high)
        sides = offset_px[band & ~right], offset_px[band & right]
        enough = min(map(len, sides)) >= FEWEST_SAMPLES
        out.append(float(np.median(sides[0]) - np.median(sides[1])) if enough else 0.0)
    return np.array(out)


def shadow_sd_mm(evidence: RimEvidence) -> Float[np.ndarray, " k"]:
    """What such a shadow makes uncertain at each sample, mm: the difference of its band, 0 where not noticed.

    The mesh settles between the two sides; below the lowest band, where no side is clear of the shadow, the
    worst band's counts.
    """
    apart = np.abs(left_right_px(evidence))
    apart = np.where(apart > NOTICED_PX, apart, 0.0)
    height_deg = np.degrees(np.arcsin(np.clip(np.sin(evidence.turn), -1, 1)))
    band = np.searchsorted(HEIGHTS_DEG, height_deg, side="right") - 1
    by_band = np.concatenate([apart, [0.0, apart.max()]])
    return np.asarray(by_band[np.clip(band, -1, len(apart))] * evidence.pixel_mm)

"""Markers that the frame's edge cuts: where their centres are, from the centroid of what is left of them.

Of a disc of radius r whose centre lies s inside a straight edge the part in view has its centroid at

    m(s) = s + (2/3) (r^2 - s^2)^(3/2) / A(s),   A(s) = r^2 (pi - acos(s/r)) + s sqrt(r^2 - s^2)

inside that edge. m grows with s, so that it tells s; at s = r nothing is cut and m = r.
"""

import cv2
import numpy as np
from jaxtyping import Float

from tactile.markers.marker_detection import Blobs

OUTSIDE = 0.2
"""A centre may lie this many radii outside the frame: two fifths of the disc are then in view."""
STEPS = 60
"""Of the table of m(s), straight between: a fortieth of a radius each."""


def disc_radius_px(shown: Float[np.ndarray, "h w"], markers: Blobs) -> float:
    """The markers' radius: that of a disc of the (median) area on which contrast exceeds half its peak."""
    over = (shown > 0.5 * float(np.median(markers.peak))).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(over, connectivity=4)
    columns, rows = np.rint(markers.centre_px).astype(np.int64).T
    mine = labels[rows, columns]
    areas = stats[mine[mine > 0], cv2.CC_STAT_AREA]
    return float(np.sqrt(np.median(areas) / np.pi)) if len(areas) else 0.0


def uncut(
    centroid_px: Float[np.ndarray, "n 2"], shape: tuple[int, ...], radius_px: float
) -> Float[np.ndarray, "n 2"]:
    """Centres of the discs whose visible parts have these centroids, in a frame of (height, width).

    Pixels are squares around whole coordinates: the frame's edges lie at -0.5. Each axis is taken by itself,
    which is exact but for the corners.
    """
    s = np.linspace(-1.5 * OUTSIDE, 1.0, STEPS)
    area = np.pi - np.arccos(s) + s * np.sqrt(1.0 - s**2)
    seen_at = (s + 2.0 / 3.0 * (1.0 - s**2) ** 1.5 / area) * radius_px
    centre = centroid_px.copy()
    for axis, size in enumerate((shape[1], shape[0])):
        for sign, edge in ((1.0, -0.5), (-1.0, size - 0.5)):
            within = sign * (centroid_px[:, axis] - edge)
            cut = within < radius_px
            centre[cut, axis] = edge + sign * np.interp(within[cut], seen_at, s * radius_px)
    return centre

"""Markers of one frame, found to a fraction of a pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactile.markers.contrast import MarkerLook

WINDOW_RADII = 1.7
"""Half the width of the window a centroid is taken in, in marker radii."""
FLOOR = 0.3
"""Contrast below this share of the marker's own peak does not weigh: it is shade, not marker."""
CENTRE_STEPS = 6
"""Of moving a window onto its own centroid, at most; SETTLED_PX mostly ends them before."""
STATIONARY_PX = 0.01
"""px of a step below which a centre is found: a third of a frame's noise of 0.03 px (eight
real clips)."""
LEAST_CONTRAST = 0.08
"""A marker is at least this much darker or lighter than its gel."""
UNLIKE = 3.0
"""A blob whose mass or peak differs from the median by more than this factor is no marker."""
NEAR = 0.55
"""Two blobs nearer than this share of the usual spacing are one marker and its glint."""


@dataclass(frozen=True, kw_only=True)
class Blobs:
    """Candidate markers of a frame: centre (px), peak contrast, and mass (sum of contrast, px^2)."""

    centre_px: Float[np.ndarray, "n 2"]
    peak: Float[np.ndarray, " n"]
    mass: Float[np.ndarray, " n"]

    def of(self, keep: Bool[np.ndarray, " n"]) -> "Blobs":
        """The blobs that `keep` names."""
        return Blobs(centre_px=self.centre_px[keep], peak=self.peak[keep], mass=self.mass[keep])


def find_blobs(shown: Float[np.ndarray, "h w"], look: MarkerLook, *, least: float) -> Blobs:
    """Every local maximum of the contrast smoothed to a marker's size that reaches `least`, sub-pixel."""
    step = max(1, int(look.radius_px // 4))  # maxima are only a start: a coarser frame finds them
    height, width = shown.shape
    small = (
        cv2.resize(shown, (width // step, height // step), interpolation=cv2.INTER_AREA)
        if step > 1
        else shown
    )
    smooth = cv2.GaussianBlur(small, (0, 0), 0.5 * look.radius_px / step)
    side = 2 * int(np.ceil(look.radius_px / step)) + 1
    highest = cv2.dilate(smooth, np.ones((side, side), dtype=np.uint8))
    rows, columns = np.divmod(np.flatnonzero((smooth >= highest) & (smooth >= least)), small.shape[1])
    start = (np.stack([columns, rows], axis=1) + 0.5) * [
        width / small.shape[1],
        height / small.shape[0],
    ] - 0.5
    return centred(shown, start, look)


def centred(shown: Float[np.ndarray, "h w"], start_px: Float[np.ndarray, "n 2"], look: MarkerLook) -> Blobs:
    """Each start moved to the centroid of the contrast around it, again and again until it stays.

    The window tapers to its rim, so that a neighbour or the frame's noise does not pull; the fixed point is
    the marker's centre wherever the marker is symmetric. Outside the frame the contrast is zero.
    """
    half = int(np.ceil(WINDOW_RADII * look.radius_px))
    padded = cv2.copyMakeBorder(shown, half, half, half, half, cv2.BORDER_CONSTANT, value=0)
    rows, columns = (axis.ravel() for axis in np.mgrid[-half : half + 1, -half : half + 1])
    across, down = columns.astype(np.float32), rows.astype(np.float32)
    flat, stride = padded.ravel(), padded.shape[1]
    offsets = (rows + half) * stride + columns + half
    centre = np.array(start_px, dtype=np.float64)
    peak, mass = np.zeros(len(centre)), np.zeros(len(centre))
    moving = np.arange(len(centre))
    limit = np.array([shown.shape[1] - 1.0, shown.shape[0] - 1.0])
    reach = np.float32((WINDOW_RADII * look.radius_px) ** 2)
    for _ in range(CENTRE_STEPS):
        if not len(moving):
            break
        here = np.clip(centre[moving], 0.0, limit)
        whole = np.rint(here).astype(np.int64)
        away = (here - whole).astype(np.float32)
        window = flat[(whole[:, 1] * stride + whole[:, 0])[:, None] + offsets]
        distance = (across - away[:, :1]) ** 2 + (down - away[:, 1:]) ** 2
        top = np.where(distance <= look.radius_px**2, window, 0.0).max(axis=1)
        taper = np.sqrt(np.maximum(1.0 - distance / reach, 0.0))
        weight = np.maximum(window - FLOOR * top[:, None], 0.0) * taper
        total = np.maximum(weight.sum(axis=1), 1e-9)
        shift = np.stack([weight @ across / total, weight @ down / total], axis=1) - away
        centre[moving], peak[moving] = here + shift, top
        mass[moving] = np.where(taper > 0, window, 0.0).sum(axis=1)
        moving = moving[np.abs(shift).max(axis=1) > STATIONARY_PX]
    return Blobs(centre_px=centre, peak=peak, mass=mass)


def markers_of(shown: Float[np.ndarray, "h w"], look: MarkerLook) -> Blobs:
    """The markers of an unloaded gel: blobs alike in peak and mass, one per place, whole within the frame."""
    found = find_blobs(shown, look, least=LEAST_CONTRAST)
    if not len(found.peak):
        return found
    usual_peak, usual_mass = np.median(found.peak), np.median(found.mass)
    similar = (
        (found.peak > usual_peak / UNLIKE)
        & (found.mass > usual_mass / UNLIKE)
        & (found.mass < usual_mass * UNLIKE)
    )
    found = found.of(similar & inside(found.centre_px, shown.shape, look.radius_px))
    return found.of(_alone(found))


def inside(
    centre_px: Float[np.ndarray, "n 2"], shape: tuple[int, ...], margin_px: float
) -> Bool[np.ndarray, " n"]:
    """Whether each centre is at least `margin_px` inside a frame of this (height, width)."""
    height, width = shape[:2]
    x, y = centre_px[:, 0], centre_px[:, 1]
    far = (x >= margin_px) & (y >= margin_px) & (x <= width - 1 - margin_px) & (y <= height - 1 - margin_px)
    return np.asarray(far)


def spacing_of(centre_px: Float[np.ndarray, "n 2"]) -> float:
    """The median distance of nearest neighbours, px.

    >>> spacing_of(np.array([[x, y] for x in (0.0, 12, 24) for y in (0.0, 12, 24)]))
    12.0
    """
    if len(centre_px) < 2:
        return 0.0
    return float(np.median(np.asarray(cKDTree(centre_px).query(centre_px, k=[2])[0])))


def _alone(found: Blobs) -> Bool[np.ndarray, " n"]:
    """Of blobs too near to one another the heaviest stays."""
    keep = np.ones(len(found.mass), dtype=bool)
    if len(keep) < 3:
        return keep
    tree = cKDTree(found.centre_px)
    second = np.asarray(tree.query(found.centre_px, k=[3])[0])[:, 0]
    for a, b in sorted(tree.query_pairs(NEAR * float(np.median(second)))):
        if keep[a] and keep[b]:
            keep[a if found.mass[a] < found.mass[b] else b] = False
    return keep

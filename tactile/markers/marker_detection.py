"""Detects the markers of one frame to a fraction of a pixel.

The light on a gel is uneven and drifts. Contrast = |I / background - 1| separates markers from it. The
background is the frame after a morphological closing (dark markers) or opening (light ones), smoothed.

The frame's edge cuts some markers. A disc of radius r has its centre s inside a straight edge. The centroid
of its visible part lies

    m(s) = s + (2/3) (r^2 - s^2)^(3/2) / A(s),   A(s) = r^2 (pi - acos(s/r)) + s sqrt(r^2 - s^2)

inside that edge. m grows with s, so the centroid determines s; at s = r nothing is cut and m = r.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial import cKDTree

COARSE_RADIUS_PX = 3.0
"""Approximate radius of a marker in the shrunk frame that yields the background."""
SCALES = np.geomspace(1.5, 24.0, 13)
"""Standard deviations of the blob filter, px; a disc of radius r responds most at r / sqrt(2)."""
STRONG = 0.5
"""Share of the peaks' 0.9 quantile above which a peak is a marker; weaker ones may be dirt. Set by hand."""
WINDOW_RADII = 1.7
"""Half width of a centroid's window, in marker radii."""
FLOOR = 0.3
"""Contrast below this share of the marker's peak has no weight: it is shading."""
CENTRE_STEPS = 6
"""Most steps of a window onto its centroid; STATIONARY_PX usually ends them earlier."""
STATIONARY_PX = 0.01
"""Step (px) below which a centre is final: a third of a frame's noise of 0.03 px (eight real clips)."""
LEAST_CONTRAST = 0.08
"""A marker is at least this much darker or lighter than its gel."""
UNLIKE = 3.0
"""A blob is no marker if its mass is off the median by this factor, or its peak below the median by it."""
NEAR = 0.55
"""Two blobs nearer than this share of the usual spacing are one marker and its glint."""
OUTSIDE = 0.2
"""A centre may lie this many radii outside the frame: two fifths of the disc are then in view."""
STEPS = 60
"""Points of the table of m(s), a fortieth of a radius apart, with linear interpolation."""


@dataclass(frozen=True, kw_only=True)
class MarkerLook:
    """Appearance of a sensor's markers: `radius_px`, and whether they are darker than the gel."""

    radius_px: float
    dark: bool


def grey(frame: UInt8[np.ndarray, "h w *c"]) -> Float[np.ndarray, "h w"]:
    """The mean of the channels in whole grey levels, single precision."""
    if frame.ndim == 2:
        return np.asarray(frame, dtype=np.float32)
    weights = np.full((1, frame.shape[2]), 1.0 / frame.shape[2], dtype=np.float32)
    return np.asarray(cv2.transform(frame, weights), dtype=np.uint8).astype(np.float32)


def contrast(intensity: Float[np.ndarray, "h w"], look: MarkerLook) -> Float[np.ndarray, "h w"]:
    """0 on the gel; 1 - I / background on dark markers (1 is black), I / background - 1 on light ones."""
    shrink = max(1, round(look.radius_px / COARSE_RADIUS_PX))
    height, width = intensity.shape
    size = (max(8, width // shrink), max(8, height // shrink))
    small = cv2.resize(intensity, size, interpolation=cv2.INTER_AREA)
    radius = look.radius_px / shrink
    side = 2 * int(np.ceil(1.5 * radius)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    # Mirrored margin: OpenCV's default would make the frame's edge win every maximum or minimum.
    pad = side
    framed = cv2.copyMakeBorder(small, pad, pad, pad, pad, cv2.BORDER_REFLECT_101)
    operation = cv2.MORPH_CLOSE if look.dark else cv2.MORPH_OPEN
    closed = cv2.GaussianBlur(cv2.morphologyEx(framed, operation, kernel), (0, 0), 1.5 * radius)
    background = cv2.resize(closed[pad:-pad, pad:-pad], (width, height), interpolation=cv2.INTER_LINEAR)
    ratio = intensity / np.maximum(background, 1.0)
    return np.asarray(np.maximum(1.0 - ratio if look.dark else ratio - 1.0, 0.0), dtype=np.float32)


def find_look(intensity: Float[np.ndarray, "h w"]) -> MarkerLook:
    """Radius and polarity of the blobs with the strongest response.

    The response at scale s is s^2 times the Laplacian of the Gaussian-smoothed frame, relative to the local
    brightness. The score is the median of the strong maxima times the fourth root of their number, so that
    many similar blobs outscore one large shadow.
    """
    shade = cv2.GaussianBlur(intensity, (0, 0), intensity.shape[0] / 12)
    relative = intensity / np.maximum(shade, 1.0)
    best, best_look = 0.0, MarkerLook(radius_px=4.0, dark=True)
    for scale in SCALES[intensity.shape[0] / 10 > SCALES]:
        around = np.ones((2 * int(np.ceil(1.5 * scale)) + 1,) * 2, np.uint8)
        laplacian = scale**2 * cv2.Laplacian(cv2.GaussianBlur(relative, (0, 0), scale), cv2.CV_32F, ksize=1)
        for dark in (True, False):
            answer = laplacian if dark else -laplacian
            heights = answer[(answer >= cv2.dilate(answer, around)) & (answer > 0.0)]
            strong = heights[heights > STRONG * np.quantile(heights, 0.9)] if len(heights) else heights
            score = float(np.median(strong) * len(strong) ** 0.25) if len(strong) > 3 else 0.0
            if score > best:
                best, best_look = score, MarkerLook(radius_px=float(scale * np.sqrt(2.0)), dark=dark)
    return best_look


@dataclass(frozen=True, kw_only=True)
class Blobs:
    """Candidate markers of a frame: centre (px), peak contrast, and mass (sum of contrast, px^2)."""

    centre_px: Float[np.ndarray, "n 2"]
    peak: Float[np.ndarray, " n"]
    mass: Float[np.ndarray, " n"]

    def of(self, keep: Bool[np.ndarray, " n"]) -> "Blobs":
        """Only the blobs in `keep`."""
        return Blobs(centre_px=self.centre_px[keep], peak=self.peak[keep], mass=self.mass[keep])


def find_blobs(shown: Float[np.ndarray, "h w"], look: MarkerLook, *, least: float) -> Blobs:
    """Local maxima above `least` of the contrast smoothed to a marker's size; centres are sub-pixel."""
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
    """Each start moved to the centroid of the contrast around it, until it is stationary.

    The window tapers towards its rim, so neighbours and noise have little weight. The fixed point of a
    symmetric marker is its centre. Outside the frame the contrast is zero.
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
    """Markers of an unloaded gel: blobs of similar peak and mass, one per place, whole within the frame."""
    blobs = find_blobs(shown, look, least=LEAST_CONTRAST)
    if not len(blobs.peak):
        return blobs
    usual_peak, usual_mass = np.median(blobs.peak), np.median(blobs.mass)
    similar = (
        (blobs.peak > usual_peak / UNLIKE)
        & (blobs.mass > usual_mass / UNLIKE)
        & (blobs.mass < usual_mass * UNLIKE)
    )
    blobs = blobs.of(similar & inside(blobs.centre_px, shown.shape, look.radius_px))
    return blobs.of(_alone(blobs))


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


def _alone(blobs: Blobs) -> Bool[np.ndarray, " n"]:
    """Which blobs to keep: the heaviest of those too near to each other."""
    keep = np.ones(len(blobs.mass), dtype=bool)
    if len(keep) < 3:
        return keep
    tree = cKDTree(blobs.centre_px)
    second = np.asarray(tree.query(blobs.centre_px, k=[3])[0])[:, 0]
    for a, b in sorted(tree.query_pairs(NEAR * float(np.median(second)))):
        if keep[a] and keep[b]:
            keep[a if blobs.mass[a] < blobs.mass[b] else b] = False
    return keep


def disc_radius_px(shown: Float[np.ndarray, "h w"], markers: Blobs) -> float:
    """Radius of a disc with the markers' median area of contrast above half of the median peak; 0 without."""
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

    Pixels are squares around integer coordinates: the frame's edges lie at -0.5. Each axis is corrected
    alone, which is exact except in the corners.
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

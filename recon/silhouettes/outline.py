"""A fruit's outline to a fraction of a pixel: the best closed path by log odds, then the colour step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import KDTree

from recon.cameras.camera import Camera
from recon.picture_values import sampled
from recon.silhouettes.hull import Silhouette
from recon.silhouettes.mask import Window, nearest_marked
from recon.silhouettes.star_cut import best_rings

SAMPLES = 1024
"""Samples along an outline: about one a pixel on a fruit 320 px wide."""
LEASH = 4.0
"""Cost in log odds of a shift by the whole reach: decides where nothing else does. Set by hand."""
EDGE_GAIN = 15.0
"""Largest gain in log odds of a colour step: that of several pixels of colour. Set by hand."""
EDGE_LAB = 40.0
"""Colour step with the whole gain, CIE Lab units. Set by hand."""
EDGE_PX = 2.0
"""Width on either side over which a step is averaged, px: a photo's blur."""
STEP_PX, BEND = 0.5, 2.0
"""Step between tried shifts, px, and its cost in log odds between neighbours. Set by hand."""
BAND_PX = 12.0
"""Distance from an outline, px of the photo, at which its signed distance is clipped. Set by hand."""
STEEPEST_REACH_PX = 3.0
"""Range of the search for the steepest colour change, px. Set by hand."""
STEP_BAND_PX, STEP_SHARE = (1.0, 2.5), 0.4
"""Distances, px, over which the colours inside and outside are averaged, and the fruit's share at the true
edge. At grazing angles skin mirrors the ground behind it (Fresnel), so that a share of one half lies 0.04 to
0.27 px too far in. At the true edge it is 0.34 to 0.47 (0.41 in the median of 14 sets)."""
CLEAR_STEP = 0.05
"""Least step of an edge in linear light of 0 to 1, above a photo's noise. Set by hand."""
LINEAR_LIGHT = ((np.arange(256) / 255) ** 2.2).astype(np.float32)
"""Linear light of each pixel value, at a display's usual gamma."""


@dataclass(frozen=True)
class Outline:
    """A closed curve in shrunk pixels of a window, outward normals, and the share on a clear edge."""

    points: Float[np.ndarray, "n 2"]
    normals: Float[np.ndarray, "n 2"]
    clear_share: float

    def profile(self, picture: np.ndarray, shifts: Float[np.ndarray, " k"]) -> np.ndarray:
        """A picture's values (n, k, ...) along the normals, `shifts` px outside the curve."""
        return sampled(picture, self.points[:, None] + shifts[None, :, None] * self.normals[:, None])


def outline_of(mask: Bool[np.ndarray, "h w"]) -> Outline | None:
    """The outer edge of a mask's largest part as evenly spaced samples; None for under 20 pixels."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    largest = max(contours, key=cv2.contourArea)[:, 0].astype(float)
    if len(largest) < 20:
        return None
    return _even(largest, smooth=4.0)


def snapped(
    outlines: Sequence[Outline],
    log_odds: Sequence[Float[np.ndarray, "_ _"]],
    colours: Sequence[Float[np.ndarray, "_ _ 3"]],
    *,
    reach_px: float,
    most_log_odds: float,
) -> list[Outline]:
    """The closed paths within `reach_px` of outlines that best separate the odds along a colour step.

    Sample i may shift by d along its normal. Its gain is the sum of log odds inside d less those outside. A
    colour step at d adds up to EDGE_GAIN for EDGE_LAB; LEASH (d / `reach_px`)² is deducted. Each log odds is
    at most `most_log_odds`, so that similar colours do not outweigh a clear edge. Neighbours may differ by
    one step, at a cost of BEND. Dynamic programming over the ring maximises the sum.
    """
    shifts = np.arange(-reach_px, reach_px + STEP_PX / 2, STEP_PX)
    gains = [
        _gain(outline, view_log_odds, colour, shifts, most_log_odds)
        for outline, view_log_odds, colour in zip(outlines, log_odds, colours, strict=True)
    ]
    paths = best_rings(np.array(gains, np.float32), bend=BEND, steepest=1)
    moved = [o.points + shifts[path][:, None] * o.normals for o, path in zip(outlines, paths, strict=True)]
    return [_even(points, smooth=1.5) for points in moved]


def _gain(
    outline: Outline,
    log_odds: Float[np.ndarray, "h w"],
    colours: Float[np.ndarray, "h w 3"],
    shifts: Float[np.ndarray, " k"],
    most_log_odds: float,
) -> Float[np.ndarray, "n k"]:
    """Gain of every shift of every sample along its normal (see `snapped`)."""
    step_px = float(shifts[1] - shifts[0])
    reach_px = float(shifts[-1])
    wide = round(EDGE_PX / step_px)
    longer = np.arange(-wide, len(shifts) + wide) * step_px - reach_px
    values = outline.profile(log_odds.astype(np.float32), longer[wide:-wide])
    values = np.clip(values, -most_log_odds, most_log_odds) * step_px
    total = np.cumsum(values, axis=1)
    profile = outline.profile(colours, longer)
    sums = np.cumsum(np.pad(profile, ((0, 0), (1, 0), (0, 0))), axis=1)
    k = np.arange(len(shifts)) + wide
    apart = (sums[:, k + 1 + wide] - sums[:, k + 1] - sums[:, k] + sums[:, k - wide]) / wide
    step = np.sqrt(np.einsum("nkc,nkc->nk", apart, apart))
    gain = 2 * total - values - total[:, -1:] + EDGE_GAIN * np.minimum(step / EDGE_LAB, 1.0)
    return np.asarray(gain - LEASH * (shifts / reach_px) ** 2)


def sharpened(outline: Outline, window: Window, *, search: bool) -> tuple[Outline, Window]:
    """The outline on the colour step of the whole-resolution window, which is returned unshrunk.

    F and B are the mean colours STEP_BAND_PX inside and outside. Along each normal a pixel's share of fruit
    is a = (c - B).(F - B) / |F - B|²; the edge is where a crosses STEP_SHARE. Colours from further away
    mislead: shadows on the ground deepen towards the fruit. `search`: before that the outline moves to the
    steepest colour change within STEEPEST_REACH_PX. Samples without a clear step (|F - B| small, no crossing
    nearby) get the shift of their neighbours.
    """
    whole = Window(window.image, window.corner_px, 1)
    colours = cv2.LUT(window.image, LINEAR_LIGHT)
    fine = _even(outline.points * window.shrink + (window.shrink - 1) / 2, smooth=1.0)
    if search:
        fine = _on_steepest(fine, colours)
    return _on_step(fine, colours), whole


def _on_steepest(curve: Outline, colours: Float[np.ndarray, "h w 3"]) -> Outline:
    """A curve moved to the steepest colour change nearby; nearer ones have more weight."""
    reach_px = STEEPEST_REACH_PX
    shifts = np.arange(-reach_px - 1, reach_px + 1.25, 0.5)
    profile = curve.profile(colours, shifts)
    apart = ndimage.gaussian_filter1d(profile[:, 4:] - profile[:, :-4], 1.5, axis=0, mode="wrap")
    inner = shifts[2:-2]
    slope = np.linalg.norm(apart, axis=2) * (1 - 0.3 * (inner / reach_px) ** 2)
    best = slope.argmax(axis=1)
    clear = slope.max(axis=1) > CLEAR_STEP
    if clear.sum() < 0.2 * len(clear):
        return curve
    shift = _fill_ring(np.where(clear, inner[best], 0.0), clear)
    return _even(curve.points + shift[:, None] * curve.normals, smooth=1.0)


def _on_step(curve: Outline, colours: Float[np.ndarray, "h w 3"]) -> Outline:
    """A curve moved to where the fruit's share between the bands inside and outside is STEP_SHARE."""
    (nearest_px, furthest_px), at_share = STEP_BAND_PX, STEP_SHARE
    shifts = np.arange(-furthest_px, furthest_px + 0.25, 0.5)
    profile = curve.profile(colours, shifts)
    fruit = profile[:, shifts <= -nearest_px].mean(1)
    behind = profile[:, shifts >= nearest_px].mean(1)
    step = fruit - behind
    square = np.sum(step**2, axis=1)
    share = np.sum((profile - behind[:, None]) * step[:, None], axis=2) / np.maximum(square, 1e-6)[:, None]
    share = ndimage.gaussian_filter1d(share, 1.5, axis=0, mode="wrap")
    near = np.abs(shifts) <= nearest_px
    inner, outer = share[:, :-1][:, near[:-1]], share[:, 1:][:, near[:-1]]
    crossing = (inner >= at_share) & (outer < at_share)
    where = shifts[:-1][near[:-1]] + 0.5 * (inner - at_share) / np.maximum(inner - outer, 1e-6)
    where = np.where(crossing, where, np.inf)
    pick = np.abs(where).argmin(1)
    shift = where[np.arange(len(where)), pick]
    clear = np.isfinite(shift) & (square > CLEAR_STEP**2)
    if clear.sum() < 0.2 * len(clear):
        return replace(curve, clear_share=float(clear.mean()))
    shift = _fill_ring(np.where(clear, shift, 0.0), clear)
    moved = _even(curve.points + shift[:, None] * curve.normals, smooth=1.0)
    return replace(moved, clear_share=float(clear.mean()))


def kept_near(outline: Outline, expected: Outline, *, inward_px: float) -> Outline:
    """`outline`, but `expected` wherever `outline` lies more than `inward_px` inside it.

    A hull that most views agree on is hardly larger than the fruit. An outline far inside it follows a
    highlight, a reflection or similar colours, and must not carve.
    """
    _, nearest = KDTree(expected.points).query(outline.points)
    signed = np.sum((outline.points - expected.points[nearest]) * expected.normals[nearest], axis=1)
    wrong = ndimage.binary_dilation(np.pad(signed < -inward_px, 16, mode="wrap"), iterations=8)[16:-16]
    if not wrong.any():
        return outline
    weight = ndimage.gaussian_filter1d(wrong.astype(float), 4.0, mode="wrap")[:, None]
    even = _even(outline.points * (1 - weight) + expected.points[nearest] * weight, smooth=0.5)
    return replace(even, clear_share=outline.clear_share * float(1 - wrong.mean()))


def enlarged(outline: Outline, factor: int) -> Outline:
    """An outline in pixels that are `factor` times smaller."""
    return _even(outline.points * factor + (factor - 1) / 2, smooth=0.0)


def silhouette_of_outline(outline: Outline, window: Window, camera: Camera) -> Silhouette:
    """Signed distance to the curve: exact to first order within 12 px of the photo, clipped there."""
    columns, rows = window.small_size_px
    inside = np.zeros((rows, columns), np.uint8)
    cv2.fillPoly(inside, [np.rint(outline.points * 16).astype(np.int32)], 1, shift=4)
    band = BAND_PX / window.shrink
    signed = np.where(inside > 0, band, -band).astype(np.float32)
    y, x, nearest = _nearest_samples(outline.points, (rows, columns), band)
    normals = outline.normals[nearest]
    off = (x - outline.points[nearest, 0]) * normals[:, 0] + (y - outline.points[nearest, 1]) * normals[:, 1]
    signed[y, x] = np.clip(-off, -band, band)
    return Silhouette(signed * window.shrink, window, camera)


def _nearest_samples(
    points: Float[np.ndarray, "n 2"], shape: tuple[int, int], within_px: float
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Rows and columns of the pixels near a curve, and the nearest sample of each, to about a sample."""
    column, row = np.rint(points).astype(int).T
    there = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
    sample = np.full(shape, -1)
    sample[row[there], column[there]] = np.flatnonzero(there)
    distance, nearest = nearest_marked(sample >= 0)
    y, x = np.nonzero(distance < within_px)
    return y, x, sample.ravel()[nearest[y, x]]


def _fill_ring(values: Float[np.ndarray, " n"], known: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    weight = ndimage.gaussian_filter1d(known.astype(float), 6.0, mode="wrap")
    smooth = ndimage.gaussian_filter1d(values * known, 6.0, mode="wrap") / np.maximum(weight, 1e-3)
    return np.where(known, np.clip(values, smooth - 0.7, smooth + 0.7), smooth)


def _even(points: Float[np.ndarray, "n 2"], *, smooth: float) -> Outline:
    """Resample a closed curve to even spacing; normals from a slightly smoothed copy, pointing outward."""
    closed = np.concatenate([points, points[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0, along[-1], SAMPLES, endpoint=False)
    even = np.stack([np.interp(at, along, closed[:, k]) for k in (0, 1)], axis=1)
    samples_per_px = SAMPLES / max(float(along[-1]), 1e-6)
    if smooth > 0:
        even = ndimage.gaussian_filter1d(even, smooth * samples_per_px, axis=0, mode="wrap")
    smoother = ndimage.gaussian_filter1d(even, 2 * samples_per_px, axis=0, mode="wrap")
    tangent = np.roll(smoother, -1, 0) - np.roll(smoother, 1, 0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    area = np.sum(even[:, 0] * np.roll(even[:, 1], -1) - even[:, 1] * np.roll(even[:, 0], -1))
    return Outline(even, normal if area > 0 else -normal, 0.0)

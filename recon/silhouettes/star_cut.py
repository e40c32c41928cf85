"""The best closed contours around points, by log odds and colour steps, with dynamic programming."""

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.picture_values import sampled


def best_rings(gain: Float[np.ndarray, "v n k"], *, bend: float, steepest: int) -> Int[np.ndarray, "v n"]:
    """The closed path of each ring of n samples over k states with the greatest sum of gains.

    Neighbouring samples may differ by at most `steepest` states, at a cost of `bend` a state. A first run
    from the ring's far side finds the state at sample 0; a second one starts and ends there (dynamic
    programming, Viterbi 1967). It is nearly exact: only that state comes from an open path.
    """
    count = gain.shape[1]
    middle = count // 2
    free = _paths(np.roll(gain, middle, axis=1), None, bend, steepest)
    return _paths(gain, free[:, middle], bend, steepest)


def _paths(
    gain: Float[np.ndarray, "v n k"], fixed: Int[np.ndarray, " v"] | None, bend: float, steepest: int
) -> Int[np.ndarray, "v n"]:
    """The best path of each ring by dynamic programming, its two ends at `fixed` or free."""
    rings, count, width = gain.shape
    every = np.arange(rings)
    low = np.float32(-1e9)
    best = gain[:, 0].astype(np.float32)
    if fixed is not None:
        best = np.full_like(best, low)
        best[every, fixed] = gain[every, 0, fixed]
    back = np.zeros((count, rings, width), np.int8)
    wide = np.full((rings, width + 2 * steepest), low)
    for i in range(1, count):
        wide[:, steepest : steepest + width] = best
        for move in range(1, steepest + 1):
            for way in (-move, move):
                other = wide[:, steepest + way : steepest + way + width] - np.float32(bend * move)
                np.copyto(back[i], way, where=other > best)
                np.maximum(best, other, out=best)
        best += gain[:, i]
    path = np.zeros((rings, count), int)
    path[:, -1] = best.argmax(axis=1) if fixed is None else fixed
    for i in range(count - 1, 0, -1):
        path[:, i - 1] = path[:, i] + back[i, every, path[:, i]]
    return path


RAYS = 384
"""Rays about a centre: about one a degree, a pixel apart at a radius of 60."""
STEP_PX = 1.0
"""Step along a ray, px."""
MOST_LOG_ODDS = 1.5
"""Limit for one pixel: 4 to 1, so that the whole contour decides, not a patch of odd colour. Set by hand."""
EDGE_GAIN = 18.0
"""Largest gain in log odds of a colour step: that of a dozen pixels. Set by hand."""
EDGE_LAB = 25.0
"""Colour step with the whole gain, CIE Lab units. Set by hand."""
EDGE_PX = 2
"""Steps on either side over which a colour step is measured: a photo's blur."""
BEND = 3.0
"""Cost in log odds of a step between neighbouring rays: two pixels of colour. Set by hand."""
STEEPEST = 5
"""Most steps between neighbouring rays: within 18 degrees of the ray at a radius of 100 px."""
BEYOND_PX, FEWEST_RADII = 6.0, 8
"""Length of rays beyond the last pixel that may be fruit, px, and their least number of steps."""


def star_cuts(
    log_odds: Sequence[Float[np.ndarray, "_ _"]],
    colours: Sequence[Float[np.ndarray, "_ _ 3"]],
    centres: Sequence[Float[np.ndarray, "2"]],
) -> list[Bool[np.ndarray, "_ _"]]:
    """The region of each picture, star-shaped about its centre (column, row), that best separates the odds.

    Along each of RAYS rays the contour lies at one radius r. Its gain is the sum of the log odds inside r
    less those outside, each clipped to +-MOST_LOG_ODDS. A colour step at r adds up to EDGE_GAIN. Radii of
    neighbouring rays differ by at most STEEPEST steps, at a cost of BEND a step. Dynamic programming round
    the ring finds this minimum cut with a star-shape prior (Veksler 2008).
    """
    gains = [_gain(o, c, centre) for o, c, centre in zip(log_odds, colours, centres, strict=True)]
    longest = max(g.shape[1] for g in gains)
    stacked = np.full((len(gains), RAYS, longest), -1e6, np.float32)
    for row, gain in zip(stacked, gains, strict=True):
        row[:, : gain.shape[1]] = gain
    paths = best_rings(stacked, bend=BEND, steepest=STEEPEST)
    masks = []
    for path, centre, picture in zip(paths, centres, log_odds, strict=True):
        contour = centre + ((path + 1) * STEP_PX)[:, None] * _rays()
        mask = np.zeros(picture.shape, np.uint8)
        cv2.fillPoly(mask, [np.rint(contour * 16).astype(np.int32)], 1, shift=4)
        masks.append(mask > 0)
    return masks


def _gain(
    log_odds: Float[np.ndarray, "h w"], colours: Float[np.ndarray, "h w 3"], centre: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "r k"]:
    """Gain of every radius of every ray (see `star_cuts`)."""
    rows, columns = log_odds.shape
    y, x = np.nonzero(log_odds > -MOST_LOG_ODDS)
    furthest = float(np.hypot(x - centre[0], y - centre[1]).max()) if len(x) else 0.0
    radii = np.arange(STEP_PX, max(furthest + BEYOND_PX, FEWEST_RADII * STEP_PX), STEP_PX)
    at = (centre + radii[None, :, None] * _rays()[:, None]).astype(np.float32)
    u, v = at[..., 0], at[..., 1]
    inside = (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
    values = sampled(log_odds.astype(np.float32), at)
    values = np.where(
        inside, np.clip(values, -MOST_LOG_ODDS, MOST_LOG_ODDS), np.float32(-0.5 * MOST_LOG_ODDS)
    )
    values *= np.float32(STEP_PX)
    total = np.cumsum(values, axis=1)
    profile = sampled(colours, at)
    apart = profile[:, 2 * EDGE_PX :] - profile[:, : -2 * EDGE_PX]
    apart *= apart
    step = np.zeros_like(total)
    step[:, EDGE_PX:-EDGE_PX] = np.sqrt(apart[..., 0] + apart[..., 1] + apart[..., 2])
    edge = np.minimum(step * np.float32(EDGE_GAIN / EDGE_LAB), np.float32(EDGE_GAIN)) * inside
    return np.asarray(2 * total - total[:, -1:] + edge, np.float32)


@cache
def _rays() -> Float[np.ndarray, "r 2"]:
    angles = np.arange(RAYS) * 2 * np.pi / RAYS
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)

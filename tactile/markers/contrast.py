"""A frame made comparable: how much darker, or lighter, than the gel around it each pixel is.

The light on a gel is uneven and drifts; a marker is told from it by contrast = |I / background - 1|, where
the background is the frame itself with the markers closed (dark ones) or opened (light ones) away and
smoothed.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

COARSE_RADIUS_PX = 3.0
"""The background is made on a frame so shrunk that a marker's radius is about this."""
SCALES = np.geomspace(1.5, 24.0, 13)
"""Standard deviations tried for blobs, px; a disc of radius r answers most at r / sqrt(2)."""
STRONG = 0.5
"""Of the 0.9 quantile of the peaks: those above are markers for sure, weaker ones may be dirt. Set by
hand."""


@dataclass(frozen=True, kw_only=True)
class MarkerLook:
    """What a sensor's markers look like: `radius_px`, and whether they are darker than the gel."""

    radius_px: float
    dark: bool


def grey(frame: UInt8[np.ndarray, "h w *c"]) -> Float[np.ndarray, "h w"]:
    """The mean of the channels, single precision."""
    if frame.ndim == 2:
        return np.asarray(frame, dtype=np.float32)
    weights = np.full((1, frame.shape[2]), 1.0 / frame.shape[2], dtype=np.float32)
    return np.asarray(cv2.transform(frame, weights), dtype=np.uint8).astype(np.float32)


def contrast(intensity: Float[np.ndarray, "h w"], look: MarkerLook) -> Float[np.ndarray, "h w"]:
    """0 on the gel, towards 1 on a marker (dark ones: 1 is black)."""
    shrink = max(1, round(look.radius_px / COARSE_RADIUS_PX))
    height, width = intensity.shape
    size = (max(8, width // shrink), max(8, height // shrink))
    small = cv2.resize(intensity, size, interpolation=cv2.INTER_AREA)
    radius = look.radius_px / shrink
    side = 2 * int(np.ceil(1.5 * radius)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    # A border of its own value: the default would let the frame's edge win every maximum or minimum.
    pad = side
    framed = cv2.copyMakeBorder(small, pad, pad, pad, pad, cv2.BORDER_REFLECT_101)
    operation = cv2.MORPH_CLOSE if look.dark else cv2.MORPH_OPEN
    closed = cv2.GaussianBlur(cv2.morphologyEx(framed, operation, kernel), (0, 0), 1.5 * radius)
    background = cv2.resize(closed[pad:-pad, pad:-pad], (width, height), interpolation=cv2.INTER_LINEAR)
    ratio = intensity / np.maximum(background, 1.0)
    return np.asarray(np.maximum(1.0 - ratio if look.dark else ratio - 1.0, 0.0), dtype=np.float32)


def find_look(intensity: Float[np.ndarray, "h w"]) -> MarkerLook:
    """Radius and polarity of the blobs that answer most.

    At each scale s the answer is s^2 times the Laplacian of the Gaussian-smoothed frame, in parts of the
    local brightness; the score is the median of the strong maxima times the fourth root of how many there
    are, so that many like blobs win over one large shade.
    """
    shade = cv2.GaussianBlur(intensity, (0, 0), intensity.shape[0] / 12)
    relative = intensity / np.maximum(shade, 1.0)
    best, found = 0.0, MarkerLook(radius_px=4.0, dark=True)
    for scale in SCALES[intensity.shape[0] / 10 > SCALES]:
        laplacian = scale**2 * cv2.Laplacian(cv2.GaussianBlur(relative, (0, 0), scale), cv2.CV_32F, ksize=1)
        for dark in (True, False):
            answer = laplacian if dark else -laplacian
            heights = answer[_maxima(answer, scale)]
            strong = heights[heights > STRONG * np.quantile(heights, 0.9)] if len(heights) else heights
            score = float(np.median(strong) * len(strong) ** 0.25) if len(strong) > 3 else 0.0
            if score > best:
                best, found = score, MarkerLook(radius_px=float(scale * np.sqrt(2.0)), dark=dark)
    return found


def _maxima(answer: Float[np.ndarray, "h w"], scale: float) -> "np.ndarray":
    side = 2 * int(np.ceil(1.5 * scale)) + 1
    highest = cv2.dilate(answer, cv2.getStructuringElement(cv2.MORPH_RECT, (side, side)))
    return np.asarray((answer >= highest) & (answer > 0.0))

"""Which pixels are fruit: log odds of each pixel's colour under the fruit against the ground behind it."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from recon.cameras.camera import Camera
from recon.silhouettes.background_plate import BackgroundPlate, background_in_view

LIGHTNESS_WEIGHT = 0.4
"""Of L* against a* and b* in a distance of colours: shading changes lightness and hardly hue. Set by hand."""
BINS = 24
"""Of the palette's histogram along each side: 4 of L* and 8 of a* and b* each. Set by hand."""
SMOOTHING = ((0.8, 0.8), (0.2, 2.5))
"""Shares and widths (bins) of a palette's smoothing: what was sampled, and what is near to it."""
MOST_LOG_ODDS = 6.0
"""Of one pixel: 400 to 1, so that none outvotes its neighbours. Set by hand."""
LEAST_NOISE_LAB = (1.5, 1.0)
"""Least scale of lightness and of each chroma about the plate, Lab units, as JPEG and resampling leave."""
DEGREES_OF_FREEDOM = 5.0
"""Of Student's t for noise of colours, whose tails are heavier than normal ones. Set by hand."""
DARKEST_SHADOW = 0.45
"""Least factor of L* + 16 in a shadow: a tenth of the light."""


@dataclass(frozen=True)
class Window:
    """The part of a photo around the fruit: whole-resolution pixels from `corner_px` (column, row) on.

    `image` has no channel where only its size counts.
    """

    image: UInt8[np.ndarray, "h w _"]
    corner_px: tuple[int, int]
    shrink: int

    @property
    def small_size_px(self) -> tuple[int, int]:
        """(columns, rows) once shrunk."""
        return self.image.shape[1] // self.shrink, self.image.shape[0] // self.shrink

    def small_lab(self) -> Float[np.ndarray, "h w 3"]:
        """The shrunk window in CIE Lab, L in 0..100."""
        small = cv2.resize(self.image, self.small_size_px, interpolation=cv2.INTER_AREA)
        return lab(cv2.GaussianBlur(small, (3, 3), 0.7))

    def into_small(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of the photo as pixels of the shrunk window."""
        return np.asarray((pixels - np.array(self.corner_px) - (self.shrink - 1) / 2) / self.shrink)

    def from_small(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of the shrunk window as pixels of the photo: `into_small`, undone."""
        return np.asarray(pixels * self.shrink + (self.shrink - 1) / 2 + np.array(self.corner_px))


@dataclass(frozen=True)
class Behind:
    """The ground as a photo's window would show it without the fruit: Lab colours, their range over the
    eight neighbours (registration is not exact), and where the plate is known; elsewhere the nearest known
    colour stands in.
    """

    colours: Float[np.ndarray, "h w 3"]
    lowest: Float[np.ndarray, "h w 3"]
    highest: Float[np.ndarray, "h w 3"]
    known: Bool[np.ndarray, "h w"]


def lab(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """BGR to CIE Lab as float32, L in 0..100."""
    return np.asarray(cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_BGR2Lab), np.float32)


def window_around(
    image: UInt8[np.ndarray, "h w 3"],
    camera: Camera,
    points: Float[np.ndarray, "n 3"],
    *,
    margin: float,
    small_side_px: int,
) -> Window | None:
    """The box of the points' projections, widened by `margin` of its size; None outside the picture."""
    pixels = camera.project(points)
    lowest, highest = pixels.min(0), pixels.max(0)
    grow = margin * (highest - lowest).max()
    x0, y0 = np.maximum(np.floor(lowest - grow), 0).astype(int).tolist()
    x1, y1 = np.minimum(np.ceil(highest + grow), [camera.width_px, camera.height_px]).astype(int).tolist()
    if x1 - x0 < 16 or y1 - y0 < 16 or camera.into(points)[:, 2].min() <= 0:
        return None
    shrink = max(1, round(max(x1 - x0, y1 - y0) / small_side_px))
    return Window(image[y0:y1, x0:x1], (x0, y0), shrink)


def ground_behind(window: Window, background: BackgroundPlate, camera: Camera) -> Behind:
    """The plate as the camera's window would show it."""
    seen, known = background_in_view(
        background,
        camera,
        corner_px=window.corner_px,
        size_px=window.small_size_px,
        shrink=window.shrink,
    )
    colours = lab(cv2.GaussianBlur(seen, (3, 3), 0.7))
    if known.any() and not known.all():
        colours[~known] = colours.reshape(-1, 3)[nearest_marked(known)[1][~known]]
    cell = np.ones((3, 3), np.uint8)
    return Behind(colours, cv2.erode(colours, cell), cv2.dilate(colours, cell), known)


def nearest_marked(
    marked: Bool[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """How far the nearest marked pixel is from each (px, nearly), and its number, line by line."""
    distance, label = cv2.distanceTransformWithLabels(
        (~marked).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    number = np.zeros(int(label.max()) + 1, int)
    number[label[marked]] = np.flatnonzero(marked)
    return distance, number[label]


def difference(colours: Float[np.ndarray, "*n 3"], behind: Behind) -> Float[np.ndarray, "*n 3"]:
    """Lab colour less the nearest one in the plate's range."""
    return np.asarray(colours - np.minimum(np.maximum(colours, behind.lowest), behind.highest))


def plate_log_odds(colours: Float[np.ndarray, "h w 3"], behind: Behind) -> Float[np.ndarray, "h w"]:
    """Log odds from the plate alone, before the fruit's colours are known; 0 where the plate is not known.

    Lightness is weighted down, against shadows that were cast in some photos only.
    """
    weight = np.array([LIGHTNESS_WEIGHT, 1, 1], np.float32)
    distance = np.linalg.norm(difference(colours, behind) * weight, axis=2)
    quiet = float(np.median(distance[behind.known])) if behind.known.any() else 0.0
    threshold = 9.0 + 2.0 * min(quiet, 5.0)
    return np.where(behind.known, np.clip((distance - threshold) / 2, -MOST_LOG_ODDS, MOST_LOG_ODDS), 0.0)


def cells_of(colours: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, "*n"]:
    """The cell of a BINS x BINS x BINS histogram over the Lab range that each colour falls in."""
    step = np.array([BINS / 100, BINS / 200, BINS / 200], np.float32)
    index = np.clip((colours + np.array([0, 100, 100], np.float32)) * step, 0, BINS - 1).astype(np.int16)
    return np.asarray((index[..., 0] * BINS + index[..., 1]) * BINS + index[..., 2], np.int16)


def colour_density(cells: Int[np.ndarray, " n"]) -> Float[np.ndarray, " c"]:
    """Smoothed histogram of colours given by their cells, per Lab unit cubed."""
    counts = np.bincount(cells, minlength=BINS**3).reshape(BINS, BINS, BINS).astype(np.float32)
    smooth = np.zeros_like(counts)
    for share, width in SMOOTHING:
        smooth += share * ndimage.gaussian_filter(counts, width, mode="nearest")
    cell = (100 / BINS) * (200 / BINS) ** 2
    return np.asarray(smooth.ravel() / max(len(cells), 1) / cell, np.float32)


def tidy(log_odds: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels with the odds for fruit, without specks and pinholes."""
    smooth = cv2.GaussianBlur(log_odds.astype(np.float32), (5, 5), 1.0)
    mask, disc = (smooth > 0).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
    return np.asarray(ndimage.binary_fill_holes(mask))

"""Which pixels are fruit: the odds of each pixel's colour under the fruit against the clean plate behind
it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from recon.camera import Camera
from recon.plate import Plate, plate_seen_by

LIGHTNESS_WEIGHT = 0.4
BINS = 24
MOST_LOG_ODDS = 6.0
UNSEEN_DENSITY = 1e-6


@dataclass(frozen=True)
class Window:
    """The part of a photo around the fruit: whole-resolution pixels from `corner_px` (column, row) on."""

    image: UInt8[np.ndarray, "h w 3"]
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


@dataclass(frozen=True)
class Palette:
    """Colour densities (per Lab unit cubed) of the fruit and of what is no fruit, from sure pixels of all
    views.
    """

    fruit: Float[np.ndarray, "b b b"]
    other: Float[np.ndarray, "b b b"]


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
    """The box of the points' projections, widened by `margin` of its size; None where it misses the
    picture.
    """
    pixels = camera.project(points)
    lowest, highest = pixels.min(0), pixels.max(0)
    grow = margin * (highest - lowest).max()
    x0, y0 = np.maximum(np.floor(lowest - grow), 0).astype(int).tolist()
    x1, y1 = np.minimum(np.ceil(highest + grow), [camera.width_px, camera.height_px]).astype(int).tolist()
    if x1 - x0 < 16 or y1 - y0 < 16 or camera.into(points)[:, 2].min() <= 0:
        return None
    shrink = max(1, round(max(x1 - x0, y1 - y0) / small_side_px))
    return Window(image[y0:y1, x0:x1], (x0, y0), shrink)


def plate_difference(
    colours: Float[np.ndarray, "h w 3"], window: Window, plate: Plate, camera: Camera
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Lab colour less the plate's behind it (lightness weighted down, against shadows), and where the plate
    is known.

    A pixel may differ from its own plate pixel for want of registration: the smallest difference to the
    plate's range over the eight neighbours counts.
    """
    behind, known = plate_seen_by(
        plate, camera, corner_px=window.corner_px, size_px=window.small_size_px, shrink=window.shrink
    )
    plate_lab = lab(cv2.GaussianBlur(behind, (3, 3), 0.7))
    cell = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(plate_lab, cell), cv2.dilate(plate_lab, cell)
    difference = colours - np.clip(colours, low, high)
    return difference * np.array([LIGHTNESS_WEIGHT, 1, 1], np.float32), known


def first_odds(
    difference: Float[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Log odds from the plate alone, before the fruit's colours are known; 0 where the plate is not known."""
    distance = np.sqrt(np.sum(difference**2, axis=2))
    quiet = float(np.median(distance[known])) if known.any() else 0.0
    threshold = 9.0 + 2.0 * min(quiet, 5.0)
    return np.where(known, np.clip((distance - threshold) / 2, -MOST_LOG_ODDS, MOST_LOG_ODDS), 0.0)


def learn_palette(fruit: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "m 3"]) -> Palette:
    """Smoothed colour histograms of sure fruit and sure surroundings (Lab rows)."""
    return Palette(_density(fruit), _density(other))


def looks_like(
    colours: Float[np.ndarray, "h w 3"], sample: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "h w"]:
    """Where a colour is as common in a sample as nine tenths of the sample's own colours are."""
    density = _density(sample)
    return np.asarray(density[_cells(colours)] >= np.percentile(density[_cells(sample)], 10))


def colour_odds(
    colours: Float[np.ndarray, "h w 3"],
    difference: Float[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    palette: Palette,
    *,
    noise: float,
) -> Float[np.ndarray, "h w"]:
    """log p(colour | fruit) - log p(colour | behind), clipped to +-6.

    Behind a pixel is the plate where it is known: Student's t with 7 degrees of freedom and scale `noise`
    about its colour, and hardly ever (0.2 %) the surroundings' palette; that palette alone where the plate is
    not known. The fruit's palette has a floor for colours that were not among its sure pixels.
    """
    cells = _cells(colours)
    fruit, other = palette.fruit[cells] + UNSEEN_DENSITY, palette.other[cells] + UNSEEN_DENSITY
    square = np.sum(difference**2, axis=2) / noise**2
    near = LIGHTNESS_WEIGHT * 0.3 / noise**3 * (1 + square / 7) ** -5
    behind = np.where(known, near + 0.002 * other, other)
    return np.asarray(np.clip(np.log(fruit) - np.log(behind), -MOST_LOG_ODDS, MOST_LOG_ODDS))


def difference_noise(difference: Float[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"]) -> float:
    """Scale of the difference to the plate where there is no fruit, Lab units."""
    if where.sum() < 50:
        return 4.0
    return float(np.clip(1.5 * np.median(np.sqrt(np.sum(difference[where] ** 2, axis=1))), 1.5, 6.0))


def tidy(odds: Float[np.ndarray, "h w"], *, at_least: float = 0.0) -> Bool[np.ndarray, "h w"]:
    """Pixels with the odds for fruit, without specks and pinholes."""
    smooth = cv2.GaussianBlur(odds.astype(np.float32), (5, 5), 1.0)
    found = (smooth > at_least).astype(np.uint8)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    found = cv2.morphologyEx(cv2.morphologyEx(found, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
    return np.asarray(ndimage.binary_fill_holes(found))


def _cells(colours: Float[np.ndarray, "*n 3"]) -> tuple[Int[np.ndarray, "*n"], ...]:
    step = np.array([100 / BINS, 200 / BINS, 200 / BINS])
    index = np.clip(((colours + np.array([0, 100, 100])) / step).astype(int), 0, BINS - 1)
    return index[..., 0], index[..., 1], index[..., 2]


def _density(colours: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "b b b"]:
    counts = np.zeros((BINS, BINS, BINS))
    np.add.at(counts, _cells(colours), 1.0)
    smooth = ndimage.gaussian_filter(counts, 0.8, mode="nearest")
    cell = (100 / BINS) * (200 / BINS) ** 2
    return np.asarray(smooth / max(len(colours), 1) / cell)

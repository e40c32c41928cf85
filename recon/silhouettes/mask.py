"""Log odds of each pixel's colour under the fruit against the ground behind it."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from recon.cameras.camera import Camera
from recon.picture_values import Picture
from recon.silhouettes.background_plate import BackgroundPlate, background_in_view

LIGHTNESS_WEIGHT = 0.4
"""Weight of L* in a colour distance: shading changes lightness and hardly hue. Set by hand."""
BINS = 24
"""Bins of the palette's histogram along each side: 4 units of L* and 8 of a* and b* each. Set by hand."""
SMOOTHING = ((0.8, 0.8), (0.2, 2.5))
"""Shares and widths (bins) of a palette's smoothing, for sampled colours and for colours near them."""
MOST_LOG_ODDS = 6.0
"""Limit for one pixel: 400 to 1, so that none outvotes its neighbours. Set by hand."""
LEAST_NOISE_LAB = (1.5, 1.0)
"""Least scale of lightness and of each chroma about the plate, Lab units: noise of JPEG and resampling."""
CALM_SHARE, CALM_DEVIATIONS = 0.3, (0.385, 0.845)
"""The 30 % quantiles of a deviation in one and in two dimensions, in standard deviations per dimension."""
DEGREES_OF_FREEDOM = 5.0
"""Degrees of freedom of Student's t for colour noise: its tails are heavier than normal. Set by hand."""
DARKEST_SHADOW = 0.45
"""Least factor of L* + 16 in a shadow: a tenth of the light."""
SHADOW_BINS, UNSEEN_SHADOWS = 22, 0.05
"""Bins of the shadows' histogram, and the share spread evenly over all depths of shadow. Set by hand."""
LEAST_SHADOW_SHARE, UNKNOWN_SHADOW_SHARE = 0.01, 0.05
"""Least share of ground pixels that a shadow darkened since, and that share where the plate is unknown."""
STRANGER, NEARBY, STRANGE_SHARES = 10.0, 0.08, (0.005, 0.6)
"""A pixel is strange to the plate if its surroundings explain its colour this many times better. Reach of
that over the window's side; bounds of the share (the lower keeps dark skin on dark ink)."""
UNSEEN_DENSITY = 2.5e-8
"""Floor of both densities: 2 % of the pixels spread evenly over the sRGB gamut of 8e5 Lab units cubed."""
SPREAD_OF_QUANTILES = 2.07
"""Standard deviations between the quantiles 0.15 and 0.85 of a normal distribution."""


@dataclass(frozen=True)
class Window:
    """The part of a photo around the fruit: whole-resolution pixels from `corner_px` (column, row) on.

    `image` has no channel if only its size counts.
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
        """Pixels of the shrunk window as pixels of the photo: the inverse of `into_small`."""
        return np.asarray(pixels * self.shrink + (self.shrink - 1) / 2 + np.array(self.corner_px))


@dataclass(frozen=True)
class Behind:
    """The ground in a photo's window without the fruit: Lab colours, and their range over the eight
    neighbours (registration is not exact). `scatter`: that of lightness and chroma between views. `known`:
    where the plate is known; elsewhere the nearest known colour replaces it.
    """

    colours: Float[np.ndarray, "*n 3"]
    lowest: Float[np.ndarray, "*n 3"]
    highest: Float[np.ndarray, "*n 3"]
    scatter: Float[np.ndarray, "*n 2"]
    known: Bool[np.ndarray, "*n"]

    def at(self, where: np.ndarray | tuple[np.ndarray, ...] | tuple[slice, ...]) -> "Behind":
        """The same for some pixels."""
        layers = (self.colours, self.lowest, self.highest, self.scatter, self.known)
        return Behind(*(layer[where] for layer in layers))


@dataclass(frozen=True, kw_only=True)
class GroundNoise:
    """Scatter of a photo's certain ground about the plate: scales of lightness and chroma (Lab units).
    `shadow_share`: share of pixels that a shadow has darkened since. `shadow_density`: density of their k
    (`ground_density`) over SHADOW_BINS even bins of DARKEST_SHADOW..1.
    """

    lightness: float
    chroma: float
    shadow_share: float
    shadow_density: Float[np.ndarray, " b"]


def lab(image: Picture) -> Float[np.ndarray, "h w 3"]:
    """BGR to CIE Lab as float32, L in 0..100."""
    return np.asarray(cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_BGR2Lab), np.float32)


def window_around(
    image: Picture, camera: Camera, points: Float[np.ndarray, "n 3"], *, margin: float, small_side_px: int
) -> Window | None:
    """The box of the points' projections, widened by `margin` of its size; None under 16 px or behind."""
    pixels = camera.project(points)
    lowest, highest = pixels.min(0), pixels.max(0)
    grow = margin * (highest - lowest).max()
    x0, y0 = np.maximum(np.floor(lowest - grow), 0).astype(int).tolist()
    x1, y1 = np.minimum(np.ceil(highest + grow), [camera.width_px, camera.height_px]).astype(int).tolist()
    if x1 - x0 < 16 or y1 - y0 < 16 or camera.into(points)[:, 2].min() <= 0:
        return None
    shrink = max(1, round(max(x1 - x0, y1 - y0) / small_side_px))
    return Window(image[y0:y1, x0:x1], (x0, y0), shrink)


def background_scatter(background: BackgroundPlate) -> Float[np.ndarray, "s s 2"]:
    """Standard deviations (Lab) of lightness and chroma between views, on the plate's grid."""
    apart = np.abs(lab(background.bright) - lab(background.dim))
    apart[..., 1] = np.hypot(apart[..., 1], apart[..., 2]) / np.float32(np.sqrt(2))
    return np.asarray(cv2.GaussianBlur(apart[..., :2] / np.float32(SPREAD_OF_QUANTILES), (3, 3), 0.7))


def ground_behind(
    window: Window, background: BackgroundPlate, scatter: Float[np.ndarray, "s s 2"], camera: Camera
) -> Behind:
    """The plate, and its `background_scatter`, as the camera's window would show them."""
    (seen, apart), known = background_in_view(
        background,
        camera,
        (background.colours, scatter),
        corner_px=window.corner_px,
        size_px=window.small_size_px,
        shrink=window.shrink,
    )
    colours = lab(cv2.GaussianBlur(seen, (3, 3), 0.7))
    if known.any() and not known.all():
        here = nearest_marked(known)[1][~known]
        colours[~known], apart[~known] = colours.reshape(-1, 3)[here], apart.reshape(-1, 2)[here]
    cell = np.ones((3, 3), np.uint8)
    return Behind(colours, cv2.erode(colours, cell), cv2.dilate(colours, cell), apart, known)


def nearest_marked(
    marked: Bool[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """Distance from each pixel to the nearest marked one (px, nearly), and that one's row-major number."""
    distance, label = cv2.distanceTransformWithLabels(
        (~marked).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    number = np.zeros(int(label.max()) + 1, int)
    number[label[marked]] = np.flatnonzero(marked)
    return distance, number[label]


def difference(colours: Float[np.ndarray, "*n 3"], behind: Behind) -> Float[np.ndarray, "*n 3"]:
    """Lab colour less the nearest one in the plate's range."""
    return np.asarray(colours - np.minimum(np.maximum(colours, behind.lowest), behind.highest))


def first_log_odds(colours: Float[np.ndarray, "h w 3"], behind: Behind) -> Float[np.ndarray, "h w"]:
    """Log odds from the plate alone, before the fruit's colours are known; 0 where the plate is not known.

    Lightness has less weight, because some photos alone may show a shadow.
    """
    weight = np.array([LIGHTNESS_WEIGHT, 1, 1], np.float32)
    distance = np.linalg.norm(difference(colours, behind) * weight, axis=2)
    quiet = float(np.median(distance[behind.known])) if behind.known.any() else 0.0
    threshold = 9.0 + 2.0 * min(quiet, 5.0)
    return np.where(behind.known, np.clip((distance - threshold) / 2, -MOST_LOG_ODDS, MOST_LOG_ODDS), 0.0)


def ground_noise(
    colours: Float[np.ndarray, "*n 3"], behind: Behind, ground: Bool[np.ndarray, "*n"]
) -> GroundNoise:
    """Scales and shadows over pixels that are certainly ground.

    Each scale is that of a normal distribution with the same CALM_SHARE quantile of deviations. A shadow over
    half of the ground does not widen it.
    """
    where = ground & behind.known
    even = np.full(SHADOW_BINS, 1 / (1 - DARKEST_SHADOW))
    if where.sum() < 50:
        return GroundNoise(lightness=4.0, chroma=3.0, shadow_share=0.1, shadow_density=even)
    colours, behind = colours[where], behind.at(where)
    off = difference(colours, behind)
    calm_L, calm_ab = CALM_DEVIATIONS
    lightness = max(LEAST_NOISE_LAB[0], float(np.quantile(np.abs(off[:, 0]), CALM_SHARE)) / calm_L)
    apart = np.hypot(off[:, 1], off[:, 2])
    chroma = max(LEAST_NOISE_LAB[1], float(np.quantile(apart, CALM_SHARE)) / calm_ab)
    darker = off[:, 0] < -4 * lightness
    k = (colours[darker, 0] + 16) / (behind.colours[darker, 0] + 16)
    count, _ = np.histogram(k, bins=SHADOW_BINS, range=(DARKEST_SHADOW, 1.0))
    count = ndimage.gaussian_filter1d(count.astype(float), 1.0, mode="nearest")
    seen = count / max(float(count.mean()), 1e-9) if count.any() else np.ones(SHADOW_BINS)
    return GroundNoise(
        lightness=min(lightness, 6.0),
        chroma=min(chroma, 5.0),
        shadow_share=max(float(darker.mean()), LEAST_SHADOW_SHARE),
        shadow_density=even * ((1 - UNSEEN_SHADOWS) * seen + UNSEEN_SHADOWS),
    )


def ground_density(
    colours: Float[np.ndarray, "*n 3"], behind: Behind, noise: GroundNoise
) -> Float[np.ndarray, "*n"]:
    """Density (per Lab unit cubed) of a colour on the ground.

    A mixture of lit ground (Student's t about the plate's colour) and new shadows. A shadow scales L* + 16,
    a*, b* by one k in DARKEST_SHADOW..1 (light by k³, CIE 1976), as often as on certain ground. Where the
    plate is unknown the nearest known colour counts, with twice the scatter.
    """
    unsure = np.where(behind.known, np.float32(1), np.float32(2))
    shadow_share = np.where(behind.known, np.float32(noise.shadow_share), np.float32(UNKNOWN_SHADOW_SHARE))
    lightness = np.hypot(np.float32(noise.lightness), behind.scatter[..., 0]) * unsure
    chroma = np.hypot(np.float32(noise.chroma), behind.scatter[..., 1]) * unsure
    off = difference(colours, behind)
    lit = _student(off[..., 0], lightness) * _student_2(off[..., 1], off[..., 2], chroma)
    ground_L = behind.colours[..., 0] + 16
    k = (colours[..., 0] + 16) / ground_L
    a, b = (colours[..., c] - k * behind.colours[..., c] for c in (1, 2))
    bins = np.clip((k - DARKEST_SHADOW) / (1 - DARKEST_SHADOW) * SHADOW_BINS, 0, SHADOW_BINS - 1)
    depth = noise.shadow_density.astype(np.float32)[bins.astype(np.int32)] / ground_L
    dim = np.where((k > DARKEST_SHADOW) & (k <= 1), _student_2(a, b, 1.5 * chroma) * depth, 0)
    return np.asarray((1 - shadow_share) * lit + shadow_share * dim, np.float32)


def cells_of(colours: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, "*n"]:
    """Number of each colour's cell in a BINS x BINS x BINS histogram over the Lab range."""
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


def looks_like(
    colours: Float[np.ndarray, "h w 3"], sample: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "h w"]:
    """Mask of colours whose density in a sample reaches the 10 % quantile of the sample's own densities."""
    cells = cells_of(sample)
    density = colour_density(cells)
    return np.asarray(density[cells_of(colours)] >= np.percentile(density[cells], 10))


def strange_share(
    ground: Float[np.ndarray, "h w"], other: Float[np.ndarray, "h w"], sure: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Share of certain ground nearby that the photo's surroundings explain better than the plate.

    `ground` and `other` are the densities of each pixel's colour under the plate and under the palette of the
    surroundings. The share rises where the ground shines or is not flat. Normalised convolution over NEARBY
    of the window's side extends it beyond certain ground.
    """
    odd = (STRANGER * ground < other) & sure
    width = NEARBY * len(sure)
    size = (max(1, sure.shape[1] // 8), max(1, sure.shape[0] // 8))
    count, of = (
        cv2.GaussianBlur(
            cv2.resize(m.astype(np.float32), size, interpolation=cv2.INTER_AREA), (0, 0), width / 8
        )
        for m in (odd, sure)
    )
    share = cv2.resize((count + 1e-6) / (of + 1e-4), sure.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(share, *STRANGE_SHARES), np.float32)


def colour_log_odds(
    inside: Float[np.ndarray, "*n"],
    ground: Float[np.ndarray, "*n"],
    other: Float[np.ndarray, "*n"],
    strange: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """log p(colour | fruit) - log p(colour | ground), clipped to +-6, from the colour's densities.

    The ground's density is the plate's, but for the share `strange` that of the surroundings (`other`). Both
    hypotheses have a floor for colours that their certain pixels lack.
    """
    outside = (1 - strange) * ground + strange * other
    log_odds = np.log((inside + np.float32(UNSEEN_DENSITY)) / (outside + np.float32(UNSEEN_DENSITY)))
    return np.asarray(np.clip(log_odds, -MOST_LOG_ODDS, MOST_LOG_ODDS), np.float32)


def tidy(log_odds: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels with positive log odds, smoothed, without specks and holes."""
    smooth = cv2.GaussianBlur(log_odds.astype(np.float32), (5, 5), 1.0)
    mask, disc = (smooth > 0).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
    return np.asarray(ndimage.binary_fill_holes(mask))


def _student(off: Float[np.ndarray, "*n"], scale: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Student's t density in one dimension, DEGREES_OF_FREEDOM = 5: (1 + t² / 5)^-3."""
    away = 1 + (off / scale) ** 2 / DEGREES_OF_FREEDOM
    return np.asarray(0.3796 / (scale * away * away * away))


def _student_2(
    x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"], scale: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Student's t density in two dimensions, DEGREES_OF_FREEDOM = 5: (1 + r² / 5)^-3.5."""
    square = scale * scale
    away = 1 + (x * x + y * y) / (DEGREES_OF_FREEDOM * square)
    return np.asarray(1 / (2 * np.pi * square * away * away * away * np.sqrt(away)))

"""What the camera sees: skin colours by ripeness, the printed mat, the table. Linear RGB, from a seed."""

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from recon.cameras.printed_mat import Mat, tag_bits

# sRGB anchors, chosen by eye on shop nectarines
_GROUND_UNRIPE = (0.62, 0.66, 0.22)
_GROUND_RIPE = (0.93, 0.66, 0.18)
"""sRGB shares of the ripe ground colour, by eye on shop nectarines like those below."""
_BLUSH_PALE = (0.78, 0.24, 0.10)
"""sRGB shares of the blush of a fruit that is not yet ripe."""
_BLUSH_DEEP = (0.52, 0.05, 0.07)
"""sRGB shares of a ripe fruit's blush."""
_LENTICEL = (0.93, 0.80, 0.48)
"""sRGB shares of the pale specks."""
_STEM_END = (0.55, 0.50, 0.20)
"""sRGB shares of the skin in the stem cavity."""


def skin_colours(
    directions: Float[np.ndarray, "n 3"], *, ripeness: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Linear RGB of a nectarine's skin by direction: ground colour, blush, mottle and pale lenticels.

    ripeness 0 is green-yellow with a little pale blush, 1 deep red on orange.
    """
    ground = _mix(_GROUND_UNRIPE, _GROUND_RIPE, np.full(len(directions), ripeness))
    blush = _mix(
        _BLUSH_PALE, _BLUSH_DEEP, np.clip(ripeness + 0.25 * random_field(directions, 3.0, rng), 0, 1)
    )
    sunny = directions @ unit(rng.normal(size=3) * np.array([1, 1, 0.3]))
    cover = 2.2 * (ripeness - 0.42) + 0.55 * sunny + 0.45 * random_field(directions, 4.0, rng)
    cover += 0.30 * random_field(directions, 12.0, rng) + 0.16 * random_field(directions, 40.0, rng)
    colour = _between(ground, blush, 1 / (1 + np.exp(-4.5 * cover)))
    cavity = np.exp(-((np.arccos(np.clip(directions[:, 2], -1, 1)) / 0.16) ** 2))
    colour = _between(colour, np.broadcast_to(_STEM_END, colour.shape), 0.7 * cavity)
    speck = 0.75 * specks(directions, 900, 0.011, rng)
    colour = _between(colour, np.broadcast_to(_LENTICEL, colour.shape), speck)
    colour *= 1 + 0.05 * random_field(directions, 25.0, rng)[:, None]
    return linear_rgb(colour)


def mat_texture(mat: Mat, *, pixels_per_mm: float = 8.0) -> Float[np.ndarray, "h w 3"]:
    """Linear RGB print of the mat as seen from above: +x right, +y up the picture, an arrow towards +x."""
    high, wide = round(mat.height_mm * pixels_per_mm), round(mat.width_mm * pixels_per_mm)
    ink = np.ones((high, wide))
    for tag, corners in mat.corners_mm.items():
        bits = tag_bits(mat.dictionary, tag).astype(float)
        left, bottom = corners[:, 0].min(), corners[:, 1].min()
        side = corners[:, 0].max() - left
        column = round((left + mat.width_mm / 2) * pixels_per_mm)
        row = round((mat.height_mm / 2 - bottom - side) * pixels_per_mm)
        size = round(side * pixels_per_mm)
        ink[row : row + size, column : column + size] = cv2.resize(
            bits, (size, size), interpolation=cv2.INTER_NEAREST
        )
    middle, edge = high // 2, round((mat.width_mm - 3.0) * pixels_per_mm)
    span = round(5.0 * pixels_per_mm)
    tip = np.array([[edge, middle], [edge - span, middle - span // 2], [edge - span, middle + span // 2]])
    cv2.fillConvexPoly(ink, tip.astype(np.int32), 0.0)
    paper, black = np.array([0.80, 0.79, 0.76]), np.array([0.035, 0.035, 0.04])
    return np.asarray(black + ink[..., None] * (paper - black), dtype=np.float32)


def table_texture(rng: np.random.Generator, *, side_px: int = 1024) -> Float[np.ndarray, "h w 3"]:
    """Linear RGB of a wooden table: long soft grain, no detail finer than some millimetres."""
    grain = cv2.GaussianBlur(rng.normal(size=(side_px, side_px)), (0, 0), sigmaX=70, sigmaY=5)
    broad = cv2.GaussianBlur(rng.normal(size=(side_px, side_px)), (0, 0), sigmaX=160, sigmaY=60)
    tone = grain / grain.std() + broad / broad.std()
    wood = np.array([0.42, 0.27, 0.16]) * (1 + 0.13 * tone[..., None])
    return linear_rgb(np.clip(wood, 0.02, 1)).astype(np.float32)


def random_field(
    directions: Float[np.ndarray, "n 3"], frequency: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Smooth noise of unit variance: forty plane waves of about `frequency` radians per unit length."""
    waves = rng.normal(size=(40, 3)) * frequency
    phase = rng.uniform(0, 2 * np.pi, 40)
    return np.asarray(np.cos(directions @ waves.T + phase).sum(axis=1) / np.sqrt(20.0))


def specks(
    directions: Float[np.ndarray, "n 3"], count: int, widest: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Shades of `count` dots, 0.004 to `widest` radians wide: 1 in a middle, 0 between them."""
    middles = rng.normal(size=(count, 3))
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    away, nearest = cKDTree(middles).query(directions)
    width = rng.uniform(0.004, widest, count)[nearest]
    return np.asarray(np.exp(-((away / width) ** 2)))


def _mix(
    a: tuple[float, float, float], b: tuple[float, float, float], share: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    return np.asarray(np.asarray(a) + share[:, None] * (np.asarray(b) - np.asarray(a)))


def _between(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"], share: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    return np.asarray(a + share[:, None] * (b - a))


def unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """The vector at length 1."""
    return np.asarray(vector / np.linalg.norm(vector))


def linear_rgb(srgb: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Linear light of sRGB values, clipped to 0..1 (IEC 61966-2-1)."""
    srgb = np.clip(srgb, 0.0, 1.0)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)

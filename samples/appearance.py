"""Patterns that the camera sees: the printed mat, smooth noise and dots on skin."""

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from recon.cameras.printed_mat import Mat, tag_bits


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


def random_field(
    directions: Float[np.ndarray, "n 3"], frequency: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Smooth noise of unit variance: forty plane waves, wave vector components N(0, `frequency`^2)."""
    waves = rng.normal(size=(40, 3)) * frequency
    phase = rng.uniform(0, 2 * np.pi, 40)
    return np.asarray(np.cos(directions @ waves.T + phase).sum(axis=1) / np.sqrt(20.0))


def specks(
    directions: Float[np.ndarray, "n 3"], count: int, widest: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Shades of `count` random dots: exp(-(distance / width)^2), widths 0.004 to `widest` radians."""
    middles = rng.normal(size=(count, 3))
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    away, nearest = cKDTree(middles).query(directions)
    width = rng.uniform(0.004, widest, count)[nearest]
    return np.asarray(np.exp(-((away / width) ** 2)))


def unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """The vector at length 1."""
    return np.asarray(vector / np.linalg.norm(vector))


def linear_rgb(srgb: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Linear light of sRGB values, clipped to 0..1 (IEC 61966-2-1)."""
    srgb = np.clip(srgb, 0.0, 1.0)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)

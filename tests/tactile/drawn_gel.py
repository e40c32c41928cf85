"""Pictures of a gel with round markers, drawn pixel by pixel from the discs' closed form."""

import numpy as np
from jaxtyping import Float, UInt8

SHAPE = (240, 320)
PITCH_PX = 30.0
RADIUS_PX = 5.0


def grid(columns: int = 9, rows: int = 7) -> Float[np.ndarray, "n 2"]:
    """A grid of markers in the middle of the frame, off the pixel grid."""
    x, y = np.meshgrid(np.arange(columns) * PITCH_PX, np.arange(rows) * PITCH_PX)
    return np.stack([x.ravel() + 38.3, y.ravel() + 29.6], axis=1)


def bulged(
    places: Float[np.ndarray, "n 2"], px: float, *, middle: Float[np.ndarray, "2"], wide: float
) -> Float[np.ndarray, "n 2"]:
    """Markers driven outwards by up to `px`, as an incompressible gel is under a ball."""
    away = places - middle
    return places + px * away / wide * np.exp(0.5 - (away**2).sum(axis=1, keepdims=True) / 2 / wide**2)


def drawn(
    markers_px: Float[np.ndarray, "n 2"],
    *,
    light: float = 1.0,
    tilt: float = 0.3,
    dark: bool = True,
    noise: float = 0.0,
    seed: int = 0,
) -> UInt8[np.ndarray, "h w 3"]:
    """Discs with a one-pixel edge on a gel lit unevenly, `light` times brighter; noise in grey levels."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    gel = (110.0 if dark else 60.0) * light * (1.0 + tilt * (columns / SHAPE[1] - 0.5))
    cover = np.zeros(SHAPE)
    for x, y in markers_px:
        if np.isfinite(x):
            near = tuple(
                slice(max(0, int(middle - RADIUS_PX) - 1), max(0, int(middle + RADIUS_PX) + 3))
                for middle in (y, x)
            )
            disc = np.clip(RADIUS_PX + 0.5 - np.hypot(columns[near] - x, rows[near] - y), 0.0, 1.0)
            cover[near] = np.maximum(cover[near], disc)
    picture = gel * (1.0 + cover * (-0.7 if dark else 1.2))
    tinted = picture[..., None] * [1.0, 0.9, 0.8]
    tinted = tinted + np.random.default_rng(seed).normal(scale=noise, size=tinted.shape) if noise else tinted
    return np.clip(np.rint(tinted), 0, 255).astype(np.uint8)

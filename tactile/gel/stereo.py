"""Marker places from rays: what one camera leaves open along its line of sight, two cameras settle.

A camera at c that sees a point along the unit direction d says nothing along d and locates it across d to
s = pixel noise times depth over focal length: information W = (1 - d d') / s^2 (inverse covariance). Of
several cameras the point is p = (sum W)^-1 sum W c, with covariance (sum W)^-1. With an angle a between two
rays the depth's deviation is s / (sqrt 2 sin(a / 2)).
"""

import numpy as np
from jaxtyping import Float

from tactile.gel_camera import rays
from tactile.sensors import GelCamera


def ray_information(
    camera: GelCamera,
    pixels: Float[np.ndarray, "n 2"],
    *,
    noise_px: float,
    z_mm: float | Float[np.ndarray, " n"] = 0.0,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "n 3 3"]]:
    """The camera's centre and the information (1/mm^2) of its rays on points near the plane z = `z_mm`."""
    centre, direction = rays(camera, pixels)
    distance = (z_mm - centre[2]) / direction[:, 2]
    across = noise_px * distance * (direction @ camera.gel_from_camera[:3, 2]) / np.mean(camera.focal_px)
    outer = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    return centre, outer / across[:, None, None] ** 2


def triangulated(
    cameras: tuple[GelCamera, GelCamera],
    pixels: tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]],
    *,
    noise_px: float = 1.0,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Points (mm, gel frame) seen by both cameras and their information (1/mm^2); NaN where one is NaN."""
    seen = np.isfinite(pixels[0]).all(axis=1) & np.isfinite(pixels[1]).all(axis=1)
    total = np.zeros((int(seen.sum()), 3, 3))
    right = np.zeros((int(seen.sum()), 3))
    for camera, px in zip(cameras, pixels, strict=True):
        centre, information = ray_information(camera, px[seen], noise_px=noise_px)
        total += information
        right += information @ centre
    points, precision = np.full((len(seen), 3), np.nan), np.zeros((len(seen), 3, 3))
    points[seen] = np.linalg.solve(total, right[..., None])[..., 0]
    precision[seen] = total
    return points, precision

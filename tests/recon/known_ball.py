"""A ball of known place and size under cameras whose pictures of it are closed forms."""

import numpy as np
from level_camera import camera_at

from recon.cameras.camera import Camera
from recon.silhouettes.hull import Silhouette
from recon.silhouettes.mask import Window

RADIUS_MM = 20.0
DISTANCE_MM = 250.0
CENTRE = np.array([3.0, -2.0, 20.0])
SIZE_PX, FOCAL_PX = 201, 900.0
RIM_PX = FOCAL_PX * RADIUS_MM / np.sqrt(DISTANCE_MM**2 - RADIUS_MM**2)
"""Radius of the ball's picture: the tangent of asin(R / d), times the focal length."""


def directions(count: int) -> np.ndarray:
    """Nearly even unit vectors (a golden spiral)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - 5**0.5) * np.arange(count)
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def camera_towards(direction: np.ndarray, *, off_axis: np.ndarray | None = None) -> Camera:
    """A camera DISTANCE_MM from the ball's centre that looks at it, or at a point `off_axis` (mm) of it."""
    target = CENTRE + (0.0 if off_axis is None else off_axis)
    size_px = (SIZE_PX, SIZE_PX)
    return camera_at(CENTRE + DISTANCE_MM * direction, target, size_px=size_px, focal_px=FOCAL_PX)


def whole_window() -> Window:
    """The whole picture, not shrunk."""
    return Window(np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8), (0, 0), 1)


def from_rim_px() -> np.ndarray:
    """Signed distance of every pixel to the ball's rim, positive inside."""
    rows, columns = np.mgrid[:SIZE_PX, :SIZE_PX] - (SIZE_PX - 1) / 2
    return RIM_PX - np.hypot(rows, columns)


def exact_silhouette(camera: Camera) -> Silhouette:
    """The ball's silhouette in a camera that looks at its centre."""
    return Silhouette(from_rim_px().astype(np.float32), whole_window(), camera)


def inside_cone(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    """Sine of the angle between a pixel's ray and the ball's rim's, positive inside: asin(R / d) less the
    ray's angle to the centre. Its zero is the conic that the ball's picture is, on the axis or off it.
    """
    rays = np.column_stack([(pixels - camera.middle_px) / camera.focal_px, np.ones(len(pixels))])
    to_centre = camera.into(CENTRE[None])[0]
    cosine = rays @ to_centre / np.linalg.norm(rays, axis=1) / np.linalg.norm(to_centre)
    return np.sin(np.arcsin(RADIUS_MM / np.linalg.norm(to_centre)) - np.arccos(np.minimum(cosine, 1.0)))

"""Pinhole views, camera poses, and radial lens distortion."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """A pinhole view: mat frame (mm) to camera (x right, y down, z ahead), principal point central."""

    cam_from_world: Float[np.ndarray, "4 4"]
    focal_px: float
    width_px: int
    height_px: int

    @property
    def azimuth_deg(self) -> float:
        """Azimuth of the camera's position about the z axis, from +x towards +y."""
        x, y = (-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])[:2]
        return float(np.degrees(np.arctan2(y, x)))

    def pixels(self, points_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Image coordinates; the centre of the first pixel is (0, 0)."""
        seen = points_mm @ self.cam_from_world[:3, :3].T + self.cam_from_world[:3, 3]
        return np.asarray(self.focal_px * seen[:, :2] / seen[:, 2:] + _middle(self))


def direction(azimuth: float, elevation: float) -> Float[np.ndarray, " 3"]:
    """The unit vector at angles (radians) from +x towards +y and up."""
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def look_at(
    eye: Float[np.ndarray, " 3"], aim: Float[np.ndarray, " 3"], *, roll: float
) -> Float[np.ndarray, "4 4"]:
    """World to camera (4 x 4, mm) for a camera at `eye` that faces `aim`, turned by `roll` (radians) about
    its axis. Without roll the world's z axis is upright in the picture.
    """
    ahead = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * right + s * down, c * down - s * right, ahead])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ eye
    return pose


def distorted_pixels(
    pixels: Float[np.ndarray, "n 2"], view: Viewpoint, *, k1: float
) -> Float[np.ndarray, "n 2"]:
    """Pixels through the lens, r' = r (1 + k1 r^2), of pinhole `pixels`; first pixel's centre: (0, 0)."""
    middle = _middle(view)
    x = (pixels - middle) / view.focal_px
    return np.asarray(middle + view.focal_px * x * (1 + k1 * np.sum(x**2, axis=-1, keepdims=True)))


def pinhole_pixels(
    pixels: Float[np.ndarray, "n 2"], view: Viewpoint, *, k1: float
) -> Float[np.ndarray, "n 2"]:
    """The inverse of `distorted_pixels`, by fixed-point iteration."""
    middle = _middle(view)
    seen = (pixels - middle) / view.focal_px
    x = seen
    for _ in range(20):
        x = seen / (1 + k1 * np.sum(x**2, axis=-1, keepdims=True))
    return np.asarray(middle + view.focal_px * x)


def margin_px(views: Sequence[Viewpoint], *, k1: float) -> int:
    """Margin of a pinhole picture on every side that fills the distorted picture in every view, px."""
    reach = [
        pinhole_pixels(np.array([(0.0, 0.0), (0.0, (v.height_px - 1) / 2)]), v, k1=k1).min() for v in views
    ]
    return int(max(0.0, np.ceil(-min(reach)))) + (2 if k1 else 0)


def distorted_picture(
    picture: Float[np.ndarray, "h w c"], view: Viewpoint, *, k1: float, margin: int
) -> Float[np.ndarray, "h2 w2 c"]:
    """The lens's picture from a pinhole picture that is `margin` pixels larger on every side."""
    if k1 == 0.0:
        return picture[margin : margin + view.height_px, margin : margin + view.width_px]
    y, x = np.mgrid[: view.height_px, : view.width_px].astype(float)
    source = pinhole_pixels(np.stack([x.ravel(), y.ravel()], 1), view, k1=k1).reshape(*x.shape, 2)
    grid = (source + margin).astype(np.float32)
    warped = cv2.remap(
        picture.astype(np.float32), grid, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(warped)


def _middle(view: Viewpoint) -> Float[np.ndarray, " 2"]:
    return np.array([view.width_px - 1, view.height_px - 1]) / 2

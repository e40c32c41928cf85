"""A pinhole view, and how a camera looks at a place."""

from dataclasses import dataclass

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
        """Of the camera's place about the z axis, from +x towards +y."""
        x, y = (-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])[:2]
        return float(np.degrees(np.arctan2(y, x)))

    def pixels(self, points_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Image coordinates; the centre of the first pixel is (0, 0)."""
        seen = points_mm @ self.cam_from_world[:3, :3].T + self.cam_from_world[:3, 3]
        middle = np.array([self.width_px - 1, self.height_px - 1]) / 2
        return np.asarray(self.focal_px * seen[:, :2] / seen[:, 2:] + middle)


def direction(azimuth: float, elevation: float) -> Float[np.ndarray, " 3"]:
    """The unit vector at angles (radians) from +x towards +y and up."""
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def look_at(
    eye: Float[np.ndarray, " 3"], aim: Float[np.ndarray, " 3"], *, roll: float
) -> Float[np.ndarray, "4 4"]:
    """World to camera (4 x 4, mm) of a camera at `eye` that looks at `aim`, turned by `roll` (radians) about
    its axis; without roll the world's z axis is upright in the picture.
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

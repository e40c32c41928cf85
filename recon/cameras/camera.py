"""A camera with its pose. Pixel centres are integers; in camera axes x is right, y down, z ahead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from recon.cameras.photos import Photo
from recon.picture_values import Picture


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera with one radial term: u = f x (1 + k1 r²) + c, r² = x² + y². The picture's middle is
    c, and (x, y) = (X, Y) / Z in camera axes.
    """

    name: str
    width_px: int
    height_px: int
    focal_px: float
    k1: float
    cam_from_world: Float[np.ndarray, "4 4"]

    @classmethod
    def of(
        cls, photo: Photo, focal_px: float, k1: float, cam_from_world: Float[np.ndarray, "4 4"]
    ) -> "Camera":
        """The camera that took a photo."""
        height, width = photo.image.shape[:2]
        return cls(
            name=photo.name,
            width_px=width,
            height_px=height,
            focal_px=float(focal_px),
            k1=float(k1),
            cam_from_world=cam_from_world,
        )

    @property
    def middle_px(self) -> Float[np.ndarray, "2"]:
        """The principal point: the picture's middle."""
        return middle_of((self.height_px, self.width_px))

    @property
    def place(self) -> Float[np.ndarray, "3"]:
        """The camera's centre in the world."""
        return place_of(self.cam_from_world)

    @property
    def intrinsics(self) -> Float[np.ndarray, "3 3"]:
        """The matrix K of the pinhole."""
        return pinhole(self.focal_px, (self.height_px, self.width_px))

    def shows(self, pixels: Float[np.ndarray, "*n 2"], border_px: float) -> Bool[np.ndarray, "*n"]:
        """Mask of the pixels that lie more than `border_px` inside the outermost ones."""
        outermost = np.array([self.width_px - 1, self.height_px - 1])
        return np.asarray(((pixels > border_px) & (pixels < outermost - border_px)).all(axis=-1))

    def into(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """World points in the camera's axes; the third column is their depth."""
        return np.asarray(points @ self.cam_from_world[:3, :3].T + self.cam_from_world[:3, 3])

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of world points (points behind the camera give pixels without meaning).

        A camera at the origin that faces along z: 1 mm to the right, 10 mm ahead.

        >>> size = {"width_px": 101, "height_px": 101, "focal_px": 200.0, "k1": 0.0}
        >>> Camera(name="a", cam_from_world=np.eye(4), **size).project(np.array([[1.0, 0, 10]]))
        array([[70., 50.]])
        """
        return self.pixels_of(self.into(points))

    def pixels_of(self, local: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of points given in the camera's axes."""
        xy = local[:, :2] / np.where(np.abs(local[:, 2:]) < 1e-9, 1e-9, local[:, 2:])
        if self.k1:
            xy = xy * (1 + self.k1 * np.sum(xy**2, 1, keepdims=True))
        return np.asarray(xy * self.focal_px + self.middle_px)

    def pixel_mm(self, points: Float[np.ndarray, "n 3"]) -> float:
        """Width of a pixel at the points' median depth, mm."""
        return float(np.median(self.into(points)[:, 2])) / self.focal_px

    def moved(self, new_from_world: Float[np.ndarray, "4 4"]) -> "Camera":
        """The same camera in a world transformed by a similarity."""
        scale = np.cbrt(np.linalg.det(new_from_world[:3, :3]))
        cam_from_new = self.cam_from_world @ np.linalg.inv(new_from_world)
        cam_from_new[:3] *= scale
        return replace(self, cam_from_world=cam_from_new)


def middle_of(size: Sequence[int]) -> Float[np.ndarray, "2"]:
    """The middle (column, row) of a picture of (height, width) pixels."""
    return np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])


def pinhole(focal_px: float, size: tuple[int, int]) -> Float[np.ndarray, "3 3"]:
    """The matrix K of a camera whose photos are (height, width) pixels."""
    return np.array([[focal_px, 0, (size[1] - 1) / 2], [0, focal_px, (size[0] - 1) / 2], [0, 0, 1.0]])


def place_of(cam_from_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """A camera's centre in the world."""
    return np.asarray(-cam_from_world[:3, :3].T @ cam_from_world[:3, 3])


def aim_of(poses: Float[np.ndarray, "v 4 4"]) -> Float[np.ndarray, "3"]:
    """The point nearest to the optical axes of all cameras (`poses`: cam_from_world)."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for pose in poses:
        off = np.eye(3) - np.outer(pose[2, :3], pose[2, :3])
        A, b = A + off, b + off @ place_of(pose)
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


def straightened(photo: Photo, camera: Camera) -> tuple[Picture, Camera]:
    """The photo without lens distortion, and its camera."""
    if abs(camera.k1) < 1e-6:
        return photo.image, replace(camera, k1=0.0)
    image = cv2.undistort(photo.image, camera.intrinsics, np.array([camera.k1, 0.0, 0.0, 0.0]))
    return np.asarray(image, np.uint8), replace(camera, k1=0.0)

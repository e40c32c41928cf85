"""From gel points to pixels and back, through a pinhole with OpenCV's lens distortion.

A camera at c gives no information along the unit direction d to a point. Across d it locates the point to s =
pixel noise times depth over focal length: information W = (1 - d d') / s^2 (inverse covariance). Several
cameras give the point p = (sum W)^-1 sum W c, with covariance (sum W)^-1. With an angle a between two rays
the depth's standard deviation is s / (sqrt 2 sin(a / 2)).
"""

import cv2
import numpy as np
from jaxtyping import Float

from tactile.gel.gel_sides import GelOutline
from tactile.sensors import GelCamera

DOME_STEPS = 6
"""Iterations to where a ray meets a dome: each multiplies the error by the face's slope, a tenth or less."""
UNDISTORT_STEPS = 50
"""Most iterations of OpenCV's fixed-point search; it ends at 1e-12."""
SQUARE_TO = 0.03
"""Ratio of the focal lengths minus 1, up to which pixels count as square: calibrations have up to 0.004, and
dots reveal resized pictures from 0.04 on."""


def has_square_pixels(camera: GelCamera) -> bool:
    """Whether the camera's pixels are square; those of a picture resized without its proportions are not."""
    fx, fy = camera.focal_px
    return abs(fx / fy - 1.0) <= SQUARE_TO


def project(camera: GelCamera, points_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Pixels at which the camera sees points of the gel frame."""
    pose = camera.camera_from_gel
    turn, shift = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
    seen, _ = cv2.projectPoints(
        np.ascontiguousarray(points_mm, dtype=np.float64)[:, None],
        turn,
        shift,
        camera.matrix,
        np.array(camera.distortion),
    )
    return np.asarray(seen[:, 0], dtype=np.float64)


def rays(
    camera: GelCamera, pixels: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]]:
    """The camera's centre (mm) and each pixel's unit direction, both in the gel frame."""
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, UNDISTORT_STEPS, 1e-12)
    plane = cv2.undistortPoints(
        np.ascontiguousarray(pixels, dtype=np.float64)[:, None],
        camera.matrix,
        np.array(camera.distortion),
        criteria=stop,
    )[:, 0]
    forward = np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
    turned = forward @ camera.gel_from_camera[:3, :3].T
    return camera.gel_from_camera[:3, 3].copy(), turned / np.linalg.norm(turned, axis=1, keepdims=True)


def on_face(
    camera: GelCamera, pixels: Float[np.ndarray, "n 2"], z_mm: float | Float[np.ndarray, " n"] = 0.0
) -> Float[np.ndarray, "n 3"]:
    """Where each pixel's ray meets a plane of height `z_mm` in the gel frame; 0 is the undeformed face's."""
    centre, direction = rays(camera, pixels)
    reach = (z_mm - centre[2]) / direction[:, 2]
    return np.asarray(centre + reach[:, None] * direction)


def on_gel(
    camera: GelCamera, pixels: Float[np.ndarray, "n 2"], outline: GelOutline | None
) -> Float[np.ndarray, "n 3"]:
    """Where each pixel's ray meets the undeformed face, which may be domed."""
    points = on_face(camera, pixels)
    if outline is not None and outline.domed:
        for _ in range(DOME_STEPS):
            points = on_face(camera, pixels, outline.face_mm(points[:, 0], points[:, 1]))
    return points


def mm_per_px(camera: GelCamera) -> float:
    """Millimetres of the undeformed face per pixel, in the picture's middle."""
    return float(abs(camera.gel_from_camera[2, 3]) / np.mean(camera.focal_px))


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

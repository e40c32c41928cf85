"""Cameras held level: places and targets are known, so that pictures and poses are closed forms."""

import numpy as np

from recon.cameras.camera import Camera


def camera_at(place, target, *, size_px=(640, 480), focal_px=900.0, name="a", k1=0.0) -> Camera:
    """A camera at a place that looks at a target, held level (any way where it looks straight down)."""
    place = np.asarray(place, float)
    ahead = np.asarray(target, float) - place
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.999 else [1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ place
    width, height = size_px
    return Camera(name=name, width_px=width, height_px=height, focal_px=focal_px, k1=k1, cam_from_world=pose)


def direction(azimuth_deg, elevation_deg) -> np.ndarray:
    """The unit vector of an azimuth from x towards y and an elevation."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def looking_at_the_origin(azimuth_deg, elevation_deg, distance) -> np.ndarray:
    """cam_from_world (x right, y down, z ahead) of a camera held level, world z up."""
    return camera_at(distance * direction(azimuth_deg, elevation_deg), np.zeros(3)).cam_from_world

"""Cameras held level that look at the origin, for the tests of cameras from flat ground."""

import numpy as np


def looking_at_the_origin(azimuth_deg, elevation_deg, distance):
    """cam_from_world (x right, y down, z ahead) of a camera held level, world z up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    away = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(-away, right), -away])
    pose[:3, 3] = -pose[:3, :3] @ (distance * away)
    return pose

"""A gel camera with a lens, turned about y and looking at the middle of the gel."""

import numpy as np

from tactile.sensors import GelCamera

SMALL = {"away_mm": 16.0, "image_px": (320, 240), "focal_px": (260.0, 260.0), "centre_px": (159.5, 119.5)}
"""A gel camera of a few pixels."""


def turned_camera(
    turn_rad: float,
    *,
    away_mm: float = 24.0,
    image_px: tuple[int, int] = (640, 480),
    focal_px: tuple[float, float] = (740.0, 742.0),
    centre_px: tuple[float, float] = (320.0, 238.0),
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.03, 0.001, -0.001, 0.0),
) -> GelCamera:
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = -away_mm * pose[:3, 2]
    return GelCamera(
        image_px=image_px, focal_px=focal_px, centre_px=centre_px, distortion=distortion, gel_from_camera=pose
    )

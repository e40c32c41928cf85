"""First cameras from homographies of a flat ground: exact ones give back the cameras that made them."""

import numpy as np
import pytest
from level_camera import looking_at_the_origin

from recon.cameras.plane_start import start_cameras

SIZE = (720, 960)
FOCAL_PX = 1100.0
K = np.array([[FOCAL_PX, 0, (SIZE[1] - 1) / 2], [0, FOCAL_PX, (SIZE[0] - 1) / 2], [0, 0, 1.0]])


def homographies_from_first(poses):
    ground = [K @ p[:3][:, [0, 1, 3]] for p in poses]
    homographies = [g @ np.linalg.inv(ground[0]) for g in ground]
    return {i: h / h[2, 2] for i, h in enumerate(homographies)}


@pytest.mark.parametrize("nearest", [300.0, 160.0])
@pytest.mark.parametrize("known_focal_px", [FOCAL_PX, None])
def test_exact_homographies_give_focal_length_and_poses_up_to_a_similarity(nearest, known_focal_px):
    """The ground straight below the first camera lies behind the nearest one: no exception."""
    distances = np.array([400.0, 380, 420, 350, 390, nearest])
    poses = [
        looking_at_the_origin(azimuth, elevation, d)
        for azimuth, elevation, d in zip(
            (0, 55, 130, 190, 260, 4), (31, 40, 28, 52, 35, 22), distances, strict=True
        )
    ]
    focal_px, cameras = start_cameras(homographies_from_first(poses), SIZE, known_focal_px)
    assert focal_px == pytest.approx(FOCAL_PX, rel=0.02)
    true = np.array([-p[:3, :3].T @ p[:3, 3] for p in poses])
    places = np.array([-cameras[i][:3, :3].T @ cameras[i][:3, 3] for i in range(len(poses))])
    assert (places[:, 2] > 0).all()
    apart = [np.linalg.norm(x[:, None] - x, axis=2) for x in (true, places)]
    scale = apart[0].sum() / apart[1].sum()
    assert np.allclose(scale * apart[1], apart[0], rtol=0.03, atol=8.0)
    assert np.allclose(scale * places[:, 2], true[:, 2], rtol=0.03)

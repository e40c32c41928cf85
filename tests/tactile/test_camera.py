"""Pixels and gel points agree with the pinhole's own formula."""

import numpy as np
import pytest

from tactile.gel_camera import on_face, project, rays
from tactile.sensors import GelCamera

TILT = 0.1
TURN = np.array([[1, 0, 0], [0, np.cos(TILT), -np.sin(TILT)], [0, np.sin(TILT), np.cos(TILT)]])


def camera(distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)) -> GelCamera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = TURN, (0.3, -0.2, -16.0)
    return GelCamera(
        image_px=(640, 480),
        focal_px=(520.0, 510.0),
        centre_px=(320.0, 238.0),
        distortion=distortion,
        gel_from_camera=pose,
    )


def test_a_point_lands_where_the_pinhole_says() -> None:
    point = np.array([[2.0, -1.0, 0.5]])
    x, y, z = TURN.T @ (point[0] - [0.3, -0.2, -16.0])
    expected = [[520 * x / z + 320, 510 * y / z + 238]]
    np.testing.assert_allclose(project(camera(), point), expected, atol=1e-9)


def test_distortion_is_the_polynomial_in_the_radius() -> None:
    k1, k2, p1, p2, k3 = lens = (-0.2, 0.05, 0.002, -0.001, 0.01)
    point = np.array([[4.0, 3.0, 0.0]])
    x, y, z = TURN.T @ (point[0] - [0.3, -0.2, -16.0])
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    np.testing.assert_allclose(project(camera(lens), point), [[520 * u + 320, 510 * v + 238]], atol=1e-9)


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.25, 0.06, 0.001, -0.002, 0.0)])
def test_the_ray_of_a_pixel_goes_through_its_point(lens: tuple[float, float, float, float, float]) -> None:
    points = np.random.default_rng(3).uniform([-7, -5, 0], [7, 5, 0], (50, 3))
    pixels = project(camera(lens), points)
    np.testing.assert_allclose(on_face(camera(lens), pixels), points, atol=1e-6)
    centre, direction = rays(camera(lens), pixels)
    np.testing.assert_allclose(np.cross(points - centre, direction), 0.0, atol=1e-5)

"""Pixels and gel points agree with the pinhole's own formula, for one camera and for two."""

import numpy as np
import pytest
from turned_camera import turned_camera

from tactile.gel_camera import on_face, project, rays, triangulated


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.2, 0.05, 0.002, -0.001, 0.01)])
def test_a_point_lands_where_the_pinhole_and_the_polynomial_in_the_radius_say(
    lens: tuple[float, float, float, float, float],
) -> None:
    k1, k2, p1, p2, k3 = lens
    point = np.array([[4.0, 3.0, 0.0]])
    pose = turned_camera(0.1).gel_from_camera
    x, y, z = pose[:3, :3].T @ (point[0] - pose[:3, 3])
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixels = project(turned_camera(0.1, distortion=lens), point)
    np.testing.assert_allclose(pixels, [[740 * u + 320, 742 * v + 238]], atol=1e-9)


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.25, 0.06, 0.001, -0.002, 0.0)])
def test_the_ray_of_a_pixel_goes_through_its_point(lens: tuple[float, float, float, float, float]) -> None:
    points = np.random.default_rng(3).uniform([-7, -5, 0], [7, 5, 0], (50, 3))
    camera = turned_camera(0.1, distortion=lens)
    pixels = project(camera, points)
    np.testing.assert_allclose(on_face(camera, pixels), points, atol=1e-6)
    centre, direction = rays(camera, pixels)
    np.testing.assert_allclose(np.cross(points - centre, direction), 0.0, atol=1e-5)


EYES = (turned_camera(0.35), turned_camera(-0.35))
POINTS = np.random.default_rng(0).uniform([-7, -5, -1], [7, 5, 0.2], (300, 3))


def test_the_stated_information_is_that_of_noisy_pixels() -> None:
    rng = np.random.default_rng(1)
    scores = []
    for _ in range(20):
        pixels = [project(camera, POINTS) + rng.normal(scale=0.05, size=(300, 2)) for camera in EYES]
        points, information = triangulated(EYES, (pixels[0], pixels[1]), noise_px=0.05)
        miss = points - POINTS
        scores.append(np.einsum("ni,nij,nj->n", miss, information, miss))
    assert np.mean(scores) == pytest.approx(3.0, rel=0.05)


def test_depth_is_as_sure_as_the_angle_between_the_rays_makes_it() -> None:
    """s / (sqrt 2 sin 0.35) at the gel's centre, s = 0.05 px * 24 mm / 741 px."""
    middle = np.zeros((1, 3))
    _, information = triangulated(EYES, (project(EYES[0], middle), project(EYES[1], middle)), noise_px=0.05)
    depth = np.sqrt(np.linalg.inv(information[0])[2, 2])
    assert depth == pytest.approx(0.05 * 24 / 741 / np.sqrt(2) / np.sin(0.35), rel=1e-3)


def test_a_marker_lost_to_one_camera_has_no_place() -> None:
    first, second = project(EYES[0], POINTS), project(EYES[1], POINTS)
    second[7] = np.nan
    points, information = triangulated(EYES, (first, second))
    assert np.isnan(points[7]).all()
    assert not information[7].any()
    assert np.isfinite(np.delete(points, 7, axis=0)).all()

import numpy as np
import pytest
from turned_camera import turned_camera

from tactile.gel.stereo import triangulated
from tactile.gel_camera import project

EYES = (turned_camera(0.35), turned_camera(-0.35))
POINTS = np.random.default_rng(0).uniform([-7, -5, -1], [7, 5, 0.2], (300, 3))


def test_exact_pixels_give_the_point() -> None:
    found, _ = triangulated(EYES, (project(EYES[0], POINTS), project(EYES[1], POINTS)))
    np.testing.assert_allclose(found, POINTS, atol=1e-6)


def test_the_stated_information_is_that_of_noisy_pixels() -> None:
    rng = np.random.default_rng(1)
    scores = []
    for _ in range(20):
        pixels = [project(camera, POINTS) + rng.normal(scale=0.05, size=(300, 2)) for camera in EYES]
        found, information = triangulated(EYES, (pixels[0], pixels[1]), noise_px=0.05)
        miss = found - POINTS
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
    found, information = triangulated(EYES, (first, second))
    assert np.isnan(found[7]).all()
    assert not information[7].any()
    assert np.isfinite(np.delete(found, 7, axis=0)).all()

"""A fruit that moved between photos shows at its rim, in millimetres and by the photo's name."""

from functools import cache

import numpy as np
import pytest
from mat_scene import Egg, photographed, ring

from recon.cameras.printed_mat import standard_mat
from recon.checks.rim_check import rim_doubts, rim_offset
from recon.silhouettes.hull import ball

CAMERAS = ring(8)
EGG = Egg()


@cache
def images(x_mm=0.0, grow=1.0):
    """Photos of the egg moved along x, or of a larger one."""
    semi = tuple(grow * a for a in EGG.semi_mm)
    egg = Egg(semi_mm=semi, x_mm=EGG.x_mm + x_mm, y_mm=EGG.y_mm)
    return [p.image for p in photographed(CAMERAS, egg=egg, mat=standard_mat())]


def skin():
    return ball(5)[0] * EGG.semi_mm + EGG.centre


def test_photos_of_the_mesh_itself_raise_no_doubt():
    assert rim_doubts(images(), CAMERAS, skin()) == ()
    for image, camera in zip(images(), CAMERAS, strict=True):
        assert rim_offset(image, camera, skin()).shift_px < 0.4


@pytest.mark.parametrize("x_mm", [1.5, 4.0])
def test_a_shift_is_measured_as_large_as_its_projection(x_mm):
    for image, camera in zip(images(x_mm), CAMERAS, strict=True):
        centre = np.stack([EGG.centre, EGG.centre + np.array([x_mm, 0, 0])])
        before, after = camera.project(centre)
        expected = float(np.linalg.norm(after - before))
        assert rim_offset(image, camera, skin()).shift_px == pytest.approx(expected, abs=0.5)


def test_a_larger_fruit_is_measured_as_larger():
    for image, camera in zip(images(grow=1.06), CAMERAS, strict=True):
        radius = 0.06 * 26 * camera.focal_px / np.linalg.norm(camera.place - EGG.centre)
        assert rim_offset(image, camera, skin()).growth_px == pytest.approx(radius, abs=0.6)


def test_the_one_photo_with_a_moved_fruit_is_named_with_its_millimetres():
    mixed = list(images())
    mixed[3] = images(4.0)[3]
    (outlier_share,) = rim_doubts(mixed, CAMERAS, skin())
    assert "In 1 photo the fruit has another position or size" in outlier_share
    assert f"({CAMERAS[3].name} by " in outlier_share


def test_a_rim_outside_the_picture_or_without_steps_tells_nothing():
    assert rim_offset(np.full((360, 480, 3), 90, np.uint8), CAMERAS[0], skin()) is None
    assert rim_offset(images()[0], CAMERAS[0], skin() + np.array([0, 0, 90.0])) is None

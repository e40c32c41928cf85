"""Markers' residuals are carried to the skin around them, and nowhere else."""

import cv2
import numpy as np
import pytest

from recon.silhouettes.hull import ball
from reports.patch_residual import PatchResidual
from reports.residual_map import REACH, VIEW_PX, on_skin, residual_layer, residual_map

DIRECTIONS, FACES = ball(4)
SPHERE_MM = 25.0 * DIRECTIONS
PITCH_MM = 1.5


def patch():
    """Markers on the sphere about +x, PITCH_MM apart."""
    y, z = (grid.ravel() for grid in np.meshgrid(*2 * [np.arange(-6, 6.1, PITCH_MM)]))
    return np.column_stack([np.sqrt(25.0**2 - y**2 - z**2), y, z])


def test_a_constant_stays_and_a_slope_keeps_its_slope():
    places = patch()
    values, near = on_skin(SPHERE_MM, places, np.full(len(places), 7.0))
    np.testing.assert_allclose(values, 7.0)
    distance = np.linalg.norm(SPHERE_MM[:, None] - places, axis=2).min(axis=1)
    assert (near == (distance < REACH * np.median(_to_neighbour(places)))).all()
    sloped, near = on_skin(SPHERE_MM, places, 10.0 * places[:, 1])
    inner = near & (np.abs(SPHERE_MM[:, 1:]) < 4.0).all(axis=1)
    slope = np.polyfit(SPHERE_MM[inner, 1], sloped[inner], 1)[0]
    assert slope == pytest.approx(10.0, rel=0.1)


def _to_neighbour(places):
    away = np.linalg.norm(places[:, None] - places, axis=2)
    return np.sort(away, axis=1)[:, 1]


def picture(values, *others):
    """The map as BGR."""
    png = residual_map(
        SPHERE_MM, FACES, [PatchResidual(name="g, left", places_mm=patch(), residual_um=values), *others]
    )
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(int)


def test_blue_where_the_skin_went_farther_in_red_where_less():
    view = picture(np.where(patch()[:, 1] > 0, 60.0, -60.0))[:VIEW_PX, :VIEW_PX]
    red, blue = (view[..., 2] - view[..., 0]) > 60, (view[..., 0] - view[..., 2]) > 60
    assert red.sum() > 3000
    assert blue.sum() > 3000
    # y grows to the right of one who looks along -x
    assert np.argwhere(blue)[:, 1].mean() > VIEW_PX / 2 > np.argwhere(red)[:, 1].mean()
    assert np.argwhere(blue)[:, 0].mean() == pytest.approx(VIEW_PX / 2, abs=4)


def test_patches_at_one_place_keep_their_own_values():
    other = PatchResidual(name="h, left", places_mm=patch(), residual_um=np.full(len(patch()), -60.0))
    both = picture(np.full(len(patch()), 60.0), other)
    middle = VIEW_PX // 2
    first, second = both[middle, middle], both[middle, VIEW_PX + middle]
    assert first[0] > first[2] + 60
    assert second[2] > second[0] + 60


def test_noise_is_pale_on_a_bar_that_reaches_a_least_value():
    view = picture(np.random.default_rng(1).normal(0.0, 3.0, len(patch())))[:VIEW_PX, :VIEW_PX]
    assert np.abs(view[..., 2] - view[..., 0]).max() < 75


def test_a_lone_marker_makes_no_map():
    lone = PatchResidual(name="g", places_mm=patch()[:1], residual_um=np.zeros(1))
    assert residual_map(SPHERE_MM, FACES, [lone]) is None
    assert residual_map(SPHERE_MM, FACES, []) is None


def test_over_the_whole_skin_grasps_that_overlap_are_averaged():
    places = patch()
    patches = [
        PatchResidual(name=name, places_mm=places, residual_um=np.full(len(places), value))
        for name, value in (("g, left", 60.0), ("h, left", 20.0))
    ]
    layer = residual_layer(SPHERE_MM, patches)
    assert layer.values[layer.shown] == pytest.approx(40.0)
    assert (layer.values[~layer.shown] == 0).all()
    assert layer.limit == pytest.approx(60.0)
    assert 0 < layer.shown.sum() < 0.5 * len(SPHERE_MM)
    assert residual_layer(SPHERE_MM, []) is None

"""Markers' residuals are carried to the skin around them, and nowhere else."""

import numpy as np
import pytest

from recon.silhouettes.hull import ball
from reports.skin_layer import REACH, PatchResidual, on_skin, residual_layer

SPHERE_MM = 25.0 * ball(4)[0]
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


def layer_of(values):
    return residual_layer(SPHERE_MM, [PatchResidual(name="g, left", places_mm=patch(), residual_um=values)])


def test_blue_where_the_skin_went_farther_in_red_where_less():
    layer = layer_of(np.where(patch()[:, 1] > 0, 60.0, -60.0))
    (red, _, blue), y = layer.colours.T, SPHERE_MM[:, 1]
    assert (blue - red)[layer.shown & (y > 2)].min() > 0.2
    assert (red - blue)[layer.shown & (y < -2)].min() > 0.2


def test_a_lone_marker_makes_no_map():
    lone = PatchResidual(name="g", places_mm=patch()[:1], residual_um=np.zeros(1))
    assert residual_layer(SPHERE_MM, [lone]) is None


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

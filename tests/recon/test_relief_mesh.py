"""Sets of vertices and curvature of surfaces whose curvature is known."""

import numpy as np
import pytest

from recon.silhouettes.hull import ball
from recon.surface.relief_search import (
    mean_curvature,
)
from recon.triangle_mesh import vertex_normals


@pytest.mark.parametrize("radius_mm", [10.0, 30.0])
def test_a_ball_has_its_radius_as_curvature_everywhere(radius_mm):
    directions, faces = ball(4)
    curvature = mean_curvature(radius_mm * directions, directions, faces)
    np.testing.assert_allclose(curvature, -1 / radius_mm, rtol=0.01)


def test_an_ellipsoid_is_rounder_at_its_poles_than_at_its_waist_as_its_curvatures_are():
    """H = (1/r1 + 1/r2) / 2: at the pole of semi-axes (a, a, c) c / a², at the waist (1/a + a/c²) / 2."""
    directions, faces = ball(5)
    a, c = 20.0, 26.0
    points = directions * [a, a, c]
    curvature = mean_curvature(points, vertex_normals(points, faces), faces)
    pole, waist = np.abs(directions[:, 2]) > 0.995, np.abs(directions[:, 2]) < 0.05
    assert curvature[pole].mean() == pytest.approx(-c / a**2, rel=0.04)
    assert curvature[waist].mean() == pytest.approx(-(1 / a + a / c**2) / 2, rel=0.04)

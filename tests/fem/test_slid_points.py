"""Points of the skin moved along it, and fields known under the pads only."""

import numpy as np
import pytest

from fem.mesh.surface_points import locate


@pytest.fixture(scope="module")
def points(solid_ball):
    """Three points inside three faces of a ball of radius 20."""
    corners = solid_ball.nodes_mm[solid_ball.outer_faces[[3, 40, 90], :3]]
    return locate(solid_ball, corners.mean(axis=1))


def test_sliding_agrees_with_locating_anew(solid_ball, points):
    way = np.array([0.02, 0.01, -0.03])
    anew = locate(solid_ball, points.point_mm + way)
    moved = points.slid(solid_ball, way)
    assert np.abs(moved.point_mm - anew.point_mm).max() < 2e-4
    assert np.abs(moved.normal - anew.normal).max() < 1e-3


def test_a_field_known_at_a_few_nodes_is_read_as_on_the_whole_mesh(solid_ball, points):
    field = np.random.default_rng(0).normal(size=(2, len(solid_ball.nodes_mm), 3))
    nodes = np.unique(points.face_nodes)
    read = points.among(nodes).sample(field[:, nodes])
    np.testing.assert_allclose(read, points.sample(field), atol=1e-14)

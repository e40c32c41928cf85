"""The relative depth of flesh against its formula for ellipsoids."""

import numpy as np
import pytest
import trimesh

from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.relative_depth import relative_depth


def ellipsoid(half_axes_mm, centre_mm=(0.0, 0.0, 0.0)):
    ball = trimesh.creation.icosphere(subdivisions=4)
    return ball.vertices * half_axes_mm + centre_mm


def flesh_between(skin_mm, pit_mm):
    nodes = np.vstack([skin_mm, pit_mm])
    outer = np.arange(len(skin_mm) // 6 * 6).reshape(-1, 6)
    pit = np.arange(len(skin_mm), len(nodes))
    return FleshMesh(nodes, np.zeros((0, 10), dtype=np.int64), outer, pit)


def test_depth_in_a_ball_round_a_ball_is_the_share_of_the_way():
    flesh = flesh_between(ellipsoid(30.0), ellipsoid(10.0))
    direction = np.random.default_rng(0).normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    share = np.linspace(0, 1, 50)
    depth = relative_depth(flesh, direction * (30 - 20 * share)[:, None])
    np.testing.assert_allclose(depth, share, atol=2e-3)


def test_depth_between_ellipsoids_is_that_of_their_formula():
    skin_mm, pit_mm, centre_mm = np.array([29.0, 28.0, 27.0]), np.array([13.0, 9.6, 15.6]), [0.4, -0.1, 0.0]
    flesh = flesh_between(ellipsoid(skin_mm), ellipsoid(pit_mm, centre_mm))
    points = np.random.default_rng(1).uniform(-29, 29, size=(4000, 3))
    outer = np.linalg.norm(points / skin_mm, axis=1)
    inner = np.linalg.norm((points - centre_mm) / pit_mm, axis=1)
    within = (outer < 0.999) & (inner > 1.001)
    a, b = 1 - outer, (inner - 1) * pit_mm.mean() / skin_mm.mean()
    off = relative_depth(flesh, points[within]) - (a / (a + b))[within]
    assert within.sum() > 1000
    assert np.abs(off).max() < 0.015


def test_flesh_without_a_pit_is_nowhere_deep():
    flesh = flesh_between(ellipsoid(30.0), np.zeros((0, 3)))
    assert relative_depth(flesh, np.array([[0.0, 0.0, 1.0], [29.0, 0.0, 0.0]])) == pytest.approx(0.0)


def test_two_nodes_in_one_direction_count_as_their_mean():
    """Without smoothing, the interpolation has no solution there."""
    folded = np.array([[29.9, 0.0, 0.0], [27.9, 0.0, 0.0]])
    flesh = flesh_between(np.vstack([folded, ellipsoid(30.0)]), ellipsoid(10.0))
    depth = relative_depth(flesh, np.array([[28.9, 0.0, 0.0]]))
    assert depth == pytest.approx(0.0, abs=0.02)

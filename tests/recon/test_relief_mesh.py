"""Sets of vertices and curvature of surfaces whose curvature is known."""

import numpy as np
import pytest
from mat_scene import ring

from recon.silhouettes.hull import ball
from recon.surface.photo_consistency import PATCH_STEP_PX, SIDE, GreyView
from recon.surface.relief_search import (
    FLAT,
    ROUND,
    connected_parts,
    grown,
    heights_mm,
    mean_curvature,
    outline_mesh,
    patches_of,
    roundness,
    vertices_per_patch,
)
from recon.triangle_mesh import vertex_normals

RADIUS_MM = 22.0


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


def test_a_spike_counts_as_no_more_than_noise():
    directions, faces = ball(3)
    points = RADIUS_MM * directions
    points[0] *= 3.0
    assert np.abs(mean_curvature(points, directions, faces)).max() <= 3.0 / RADIUS_MM + 1e-9


def test_a_ball_is_round_and_a_plane_may_be_a_bridge():
    np.testing.assert_array_equal(roundness(np.array([-1.0, -ROUND, 0.0, 0.4])), [1.0, 1.0, 0.0, 0.0])
    assert roundness(np.array([-(FLAT + ROUND) / 2]))[0] == pytest.approx(0.5)


def test_the_outline_at_a_coarser_level_keeps_places_and_radius():
    directions, faces = ball(4)
    mesh = outline_mesh(RADIUS_MM * directions + [0.0, 0.0, 5.0], faces, 3)
    assert (mesh.level, len(mesh.outline.points)) == (3, 642)
    assert mesh.radius_mm == pytest.approx(RADIUS_MM)
    np.testing.assert_allclose(mesh.outline.normals, directions[:642], atol=0.01)
    heights = heights_mm(mesh, mesh.outline.points + 0.7 * mesh.outline.normals)
    np.testing.assert_allclose(heights, 0.7)
    np.testing.assert_allclose(
        patches_of(mesh, mesh.outline.points).curvature, mesh.outline.curvature, rtol=0.01
    )


def test_a_set_of_vertices_grows_by_rings_and_falls_into_its_parts():
    directions, faces = ball(4)
    top, foot = directions[:, 2] > 0.95, directions[:, 2] < -0.95
    parts = connected_parts(top | foot, faces)
    assert sorted(int(part.sum()) for part in parts) == sorted([int(top.sum()), int(foot.sum())])
    edge_rad = np.sqrt(4 * np.pi / len(directions) * 2 / np.sqrt(3))  # of as many even triangles' corners
    wider = grown(top, faces, 3)
    angle = np.arccos(directions[:, 2])
    reach = np.arccos(0.95) + 3 * edge_rad
    assert wider[angle < reach - 1.2 * edge_rad].all()
    assert not wider[angle > reach + edge_rad].any()
    assert connected_parts(np.zeros(len(directions), bool), faces) == []


def test_vertices_per_patch_is_the_patchs_share_of_the_balls_skin():
    directions, faces = ball(4)
    mesh = outline_mesh(RADIUS_MM * directions + [0.0, 0.0, 22.0], faces, 4)
    cameras = ring(6, width=640, height=480)
    views = [GreyView(np.zeros((480, 640), np.float32), camera) for camera in cameras]
    pixel_mm = np.median([np.linalg.norm(c.place - [0, 0, 22.0]) for c in cameras]) / cameras[0].focal_px
    patch_mm2 = ((SIDE - 1) * PATCH_STEP_PX * pixel_mm) ** 2
    expected = patch_mm2 / (4 * np.pi * RADIUS_MM**2 / len(directions))
    assert vertices_per_patch(mesh, views) == pytest.approx(expected, rel=0.02)

"""Meshes asked by rays, their edges, and what cameras see of them; Open3D that does not load is named."""

import sys

import numpy as np
import pytest

from recon.recon_failure import ReconFailure
from recon.silhouettes.hull import ball
from recon.surface.ray_mesh import consistently_oriented, open3d, seeing_views, seen_and_unseen
from recon.triangle_mesh import open_edges, sides_of, unique_edges


@pytest.mark.parametrize(
    ("why", "ends"), [("OSError('libGL.so.1')", ReconFailure), ("KeyboardInterrupt()", KeyboardInterrupt)]
)
def test_a_stop_while_a_library_is_loaded_is_no_missing_library(tmp_path, monkeypatch, why, ends):
    (tmp_path / "open3d.py").write_text(f"raise ImportError('initialization failed') from {why}\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [module for module in sys.modules if module.partition(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ends):
        open3d()


def test_a_closed_mesh_has_each_edge_once_and_each_side_knows_its_own() -> None:
    vertices, faces = ball(2)
    edges, of_side = unique_edges(faces)
    assert len(vertices) - len(edges) + len(faces) == 2  # Euler's formula
    assert np.array_equal(edges, np.unique(edges, axis=0))
    assert np.array_equal(edges[of_side], np.sort(sides_of(faces), axis=1))
    assert (np.bincount(of_side) == 2).all()


def test_faces_turned_at_random_are_consistently_oriented_again_and_one_sided_surfaces_are_left() -> None:
    _, faces = ball(3)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        mixed = np.where(rng.random((len(faces), 1)) < 0.4, faces[:, ::-1], faces)
        assert open_edges(mixed) > 0
        assert open_edges(consistently_oriented(mixed)) == 0
    strip = np.array([[k, (k + 1) % 5, (k + 2) % 5] for k in range(5)])  # of five triangles, the smallest
    assert consistently_oriented(strip) is strip
    projective_plane = np.array(
        [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 1],
         [1, 2, 4], [2, 3, 5], [3, 4, 1], [4, 5, 2], [5, 1, 3]]
    )  # fmt: skip
    assert consistently_oriented(projective_plane) is projective_plane


RADIUS = 10.0
FAR = 1e6


def test_a_far_camera_faces_half_a_ball_and_a_near_one_less():
    directions, faces = ball(5)
    vertices = RADIUS * directions
    far = seeing_views(vertices, faces, np.array([[0.0, 0.0, FAR]]))
    near = seeing_views(vertices, faces, np.array([[0.0, 0.0, 2 * RADIUS]]))
    height = vertices[:, 2] / RADIUS
    assert ((far == 1) == (height > 0))[np.abs(height) > 0.02].all()
    assert ((near == 1) == (height > 0.5))[np.abs(height - 0.5) > 0.02].all()


def test_what_two_cameras_see_together_is_a_lune_and_the_rest_is_the_hole():
    directions, faces = ball(5)
    vertices = RADIUS * directions
    across = np.array([[FAR, 0.0, 0.0], [0.0, FAR, 0.0]])
    share, hole = seen_and_unseen(vertices, faces, seeing_views(vertices, faces, across))
    assert share == pytest.approx(0.25, abs=0.008)  # a lune of 90 degrees; its rim is cut by triangles
    assert hole == pytest.approx(0.75 * 4 * np.pi * RADIUS**2, rel=0.012)

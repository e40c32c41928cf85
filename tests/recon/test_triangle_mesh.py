"""Edges of triangle meshes."""

import numpy as np

from recon.silhouettes.hull import ball
from recon.triangle_mesh import consistently_oriented, open_edges, sides_of, unique_edges


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

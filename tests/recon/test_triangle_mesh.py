"""Edges of triangle meshes."""

import numpy as np

from recon.silhouettes.hull import ball
from recon.triangle_mesh import unique_edges


def test_a_closed_mesh_has_each_edge_once_and_each_side_knows_its_own() -> None:
    vertices, faces = ball(2)
    edges, of_side = unique_edges(faces)
    assert len(vertices) - len(edges) + len(faces) == 2  # Euler's formula
    assert np.array_equal(edges, np.unique(edges, axis=0))
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert np.array_equal(edges[of_side], sides)
    assert (np.bincount(of_side) == 2).all()


def test_edges_between_large_numbers_of_32_bits_are_not_mistaken() -> None:
    edges, _ = unique_edges(np.array([[60_000, 100_000, 5]], dtype=np.int32))
    assert edges.tolist() == [[5, 60_000], [5, 100_000], [60_000, 100_000]]

import numpy as np
import pytest
from fem_shapes import box

from fem.mesh.flesh_mesh import contact_size, tetrahedralise


def square(width_mm, *, at=(0.0, 0, 0), n=9):
    axis = (np.arange(n) / (n - 1) - 0.5) * width_mm
    u, v = (a.ravel() for a in np.meshgrid(axis, axis))
    return np.column_stack([u, v, np.zeros(n * n)]) + at


@pytest.mark.parametrize(("width_mm", "edge_mm"), [(1, 0.2), (3, 0.6), (5, 1.0), (15, 1.7)])
def test_edges_are_a_fifth_of_the_contact_and_neither_tiny_nor_long(width_mm, edge_mm):
    edge, radius = contact_size(square(width_mm))
    assert np.allclose(edge, edge_mm, rtol=0.03)
    assert np.allclose(radius, 0.1 * width_mm, rtol=0.03)


def test_each_of_two_contacts_has_its_own_size():
    edge, _ = contact_size(np.vstack([square(2), square(6, at=(0, 0, 30))]))
    assert np.allclose(edge, np.repeat([0.4, 1.2], 81), rtol=0.03)


def test_markers_far_apart_still_make_one_contact_and_a_lone_one_is_small():
    assert np.allclose(contact_size(square(12, n=4))[0], 1.7)
    assert np.allclose(contact_size(np.array([[1.0, 2, 3]]))[0], 0.2)


def test_the_mesh_follows_the_contact_where_the_caller_leaves_it_to_it():
    top = square(2, at=(0, 0, 15.0))
    mesh = tetrahedralise(*box((30, 30, 30)), None, None, edge_mm=6.0, refine_at_mm=top)
    corner = mesh.nodes_mm[mesh.outer_faces[:, :3]]
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean(axis=1)
    in_contact = (np.abs(corner.mean(axis=1) - [0, 0, 15]) < [1, 1, 0.01]).all(axis=1)
    assert 0.25 < np.median(edge[in_contact]) < 0.6
    assert 3 * len(mesh.nodes_mm) < 60_000

import numpy as np
import pytest
from fem_shapes import cube_mesh, smallest_dihedral_deg

from fem.mesh.local_refinement import affordable_size, bisected, size_near, t10_dofs
from fem.mesh.tetrahedra import boundary_faces, signed_volumes_mm3


def corners_alone():
    nodes, tets = cube_mesh(2, uneven=0.2)
    return nodes[: tets[:, :4].max() + 1], tets[:, :4]


def refined():
    nodes, tets = corners_alone()
    size = size_near(np.array([[0.0, 0.0, 0.0]]), radius_mm=0.1, edge_mm=0.06, growth=0.5)
    return bisected(nodes, tets, size)


def test_bisection_fills_the_same_body_with_upright_elements_that_conform():
    nodes, tets = refined()
    volume = signed_volumes_mm3(nodes, tets)
    assert (volume > 0).all()
    assert volume.sum() == pytest.approx(1, rel=1e-13)
    faces, _ = boundary_faces(tets)
    on_wall = (np.isclose(nodes[faces], 0).all(axis=1) | np.isclose(nodes[faces], 1).all(axis=1)).any(axis=1)
    assert on_wall.all()  # a hanging node would leave unmatched faces inside


def test_edges_reach_the_wanted_length_and_no_angle_collapses():
    nodes, tets = refined()
    near = np.linalg.norm(nodes[tets].mean(axis=1), axis=1) < 0.12
    edges = np.linalg.norm(
        nodes[tets[near][:, [0, 0, 0, 1, 1, 2]]] - nodes[tets[near][:, [1, 2, 3, 2, 3, 3]]], axis=2
    )
    assert edges.max() < 0.1
    assert 0.03 < np.median(edges) < 0.08
    assert smallest_dihedral_deg(nodes, tets).min() > 8


@pytest.mark.parametrize("dof_limit", [1500, 4000])
def test_refinement_stays_within_the_dofs_allowed_and_uses_them(dof_limit):
    nodes, tets = corners_alone()
    size = affordable_size(nodes, tets, nodes[:1], radius_mm=0.1, edge_mm=0.01, dof_limit=dof_limit)
    assert 0.5 * dof_limit < t10_dofs(bisected(nodes, tets, size)[1]) <= dof_limit

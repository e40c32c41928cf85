import numpy as np
import pytest
from fem_shapes import ball, smallest_dihedral_deg

from fem.mesh.boundary_fit import t10_jacobians
from fem.mesh.closest_point import enclosed_volume_mm3
from fem.mesh.flesh_mesh import t6_volume_mm3, tetrahedralise
from fem.mesh.tetrahedra import boundary_faces


def test_fruit_and_pit_keep_their_volumes(nectarine):
    fruit = enclosed_volume_mm3(*ball(4000, semi_axes_mm=(30.5, 29.5, 28.5)))
    pit = enclosed_volume_mm3(*ball(2000, semi_axes_mm=(15, 10, 12.5)))
    volume_mm3 = t6_volume_mm3(nectarine.nodes_mm, nectarine.outer_faces)
    assert volume_mm3 == pytest.approx(fruit, rel=5e-4)
    assert volume_mm3 - nectarine.volume_mm3 == pytest.approx(pit, rel=3e-3)


def test_elements_are_well_shaped(nectarine):
    jacobian = t10_jacobians(nectarine.nodes_mm, nectarine.tets)
    assert (jacobian.min(axis=1) > 0.1 * jacobian.max(axis=1)).all()
    assert smallest_dihedral_deg(nectarine.nodes_mm, nectarine.tets[:, :4]).min() > 5


def test_every_node_of_skin_and_pit_lies_on_the_surface_given(nectarine):
    skin = nectarine.nodes_mm[nectarine.outer_nodes]
    assert np.abs(np.linalg.norm(skin / [30.5, 29.5, 28.5], axis=1) - 1).max() < 2e-3
    pit = nectarine.nodes_mm[nectarine.pit_nodes] - [0.5, -0.4, 0.8]
    assert np.abs(np.linalg.norm(pit / [15, 10, 12.5], axis=1) - 1).max() < 5e-3


def test_boundary_is_the_skin_and_the_pit_and_skin_normals_point_outward(nectarine):
    corners, _ = boundary_faces(nectarine.tets[:, :4])
    of_pit = np.isin(corners, nectarine.pit_nodes).all(axis=1)
    assert (~of_pit).sum() == len(nectarine.outer_faces)
    assert not np.isin(nectarine.pit_nodes, nectarine.outer_nodes).any()
    a, b, c = np.moveaxis(nectarine.nodes_mm[nectarine.outer_faces[:, :3]], 1, 0)
    assert (np.einsum("fx,fx->f", np.cross(b - a, c - a), a) > 0).all()


def test_mesh_is_fine_at_the_pads_and_coarse_elsewhere():
    outer = ball(4000, semi_axes_mm=(30, 29, 28))
    pad = np.array([[30.0, 0, 0]])
    mesh = tetrahedralise(
        *outer, None, None, edge_mm=7.0, refine_at_mm=pad, refine_radius_mm=4.0, refine_edge_mm=1.8
    )
    corner = mesh.nodes_mm[mesh.outer_faces[:, :3]]
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean(axis=1)
    away = np.linalg.norm(corner.mean(axis=1) - pad, axis=1)
    assert 1.2 < np.median(edge[away < 4]) < 2.2
    assert np.median(edge[away > 25]) > 4.5
    assert smallest_dihedral_deg(mesh.nodes_mm, mesh.tets[:, :4]).min() > 4
    assert t6_volume_mm3(mesh.nodes_mm, mesh.outer_faces) == pytest.approx(mesh.volume_mm3, rel=1e-12)


def test_a_cherry_is_resolved_though_edges_of_a_peach_are_asked_for():
    cherry = ball(2000, semi_axes_mm=(11, 11, 10.5)), ball(800, semi_axes_mm=(4.5, 4, 4.2))
    mesh = tetrahedralise(*cherry[0], *cherry[1], edge_mm=5.0)
    wanted = enclosed_volume_mm3(*cherry[0]) - enclosed_volume_mm3(*cherry[1])
    assert mesh.volume_mm3 == pytest.approx(wanted, rel=1e-3)
    assert len(mesh.nodes_mm) > 4000


def test_a_scan_with_noise_still_gives_a_valid_mesh():
    vertices, faces = ball(3000, semi_axes_mm=(30, 30, 30))
    vertices = vertices * (1 + np.random.default_rng(0).normal(0, 0.1 / 30, (len(vertices), 1)))
    mesh = tetrahedralise(vertices, faces, *PIT, edge_mm=6.0)
    assert (t10_jacobians(mesh.nodes_mm, mesh.tets) > 0).all()


FRUIT = ball(800, semi_axes_mm=(30, 30, 30))
PIT = ball(300, semi_axes_mm=(12, 9, 10))


def test_surfaces_wound_inside_out_give_the_same_flesh():
    mesh = tetrahedralise(FRUIT[0], FRUIT[1][:, ::-1], PIT[0], PIT[1][:, ::-1], edge_mm=8.0)
    wanted = enclosed_volume_mm3(*FRUIT) - enclosed_volume_mm3(*PIT)
    assert mesh.volume_mm3 == pytest.approx(wanted, rel=3e-3)

"""Meshes of flesh around a pit: volumes, creases, depth, local refinement, and pits that are moved."""

import numpy as np
import pytest
import trimesh
from coarse_fruit import FOOT_MM, HALF_AXES_MM, PIT_HALF_AXES_MM, PIT_MIDDLE_MM, fruit_mesh
from fem_shapes import ball, box, cube_mesh, smallest_dihedral_deg, star, tetrahedron

from fem.elements.shape_functions import TET_EDGES, TET_FACES
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh import flesh_mesh
from fem.mesh.boundary_fit import t10_jacobians
from fem.mesh.closest_point import closest_on_triangles, enclosed_volume_mm3
from fem.mesh.creases import creases_of
from fem.mesh.flesh_mesh import FleshMesh, contact_size, t6_volume_mm3, tetrahedralise
from fem.mesh.local_refinement import affordable_size, bisected, size_near, t10_dofs
from fem.mesh.relative_depth import relative_depth
from fem.mesh.tetrahedra import boundary_faces, signed_volumes_mm3
from fem.solid.moved_pit import with_pit_moved


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
    assert (~np.isin(corners, nectarine.pit_nodes).all(axis=1)).sum() == len(nectarine.outer_faces)
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


SKIN = box((30, 30, 30))
TOP = np.array([[0.0, 0, 15]])
UP = np.array([0.0, 0, 7])
CORES = {
    "cube": box((12, 12, 12)),
    "cube, 4 mm off": box((12, 12, 12), centre_mm=(0, 0, 4)),
    "cube, finely triangulated": box((12, 12, 12), cells=10),
    "star": star(12),
    "tetrahedron": tetrahedron(16),
}


def boundary_gap_mm(mesh, surface):
    """How far the surface's own vertices and edges, sampled, lie from the mesh's boundary."""
    owner, face = boundary_faces(mesh.tets[:, :4])[1].T
    quarters = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    flat = mesh.tets[owner[:, None], TET_FACES[face]][:, quarters].reshape(-1, 3)
    vertices, faces = surface
    share = np.linspace(0, 1, 12)[:, None, None, None]
    along = share * vertices[faces] + (1 - share) * vertices[np.roll(faces, 1, axis=1)]
    return closest_on_triangles(along.reshape(-1, 3), mesh.nodes_mm, flat).distance_mm.max()


@pytest.mark.parametrize("core", list(CORES))
def test_flat_sides_sharp_edges_and_corners_are_kept_exactly(core):
    mesh = tetrahedralise(*SKIN, *CORES[core], edge_mm=6.0, refine_at_mm=TOP)
    assert t6_volume_mm3(mesh.nodes_mm, mesh.outer_faces) == pytest.approx(30**3, rel=1e-12)
    wanted = 30**3 - enclosed_volume_mm3(*CORES[core])
    assert mesh.volume_mm3 == pytest.approx(wanted, rel=1e-12)
    assert boundary_gap_mm(mesh, SKIN) < 1e-9
    assert boundary_gap_mm(mesh, CORES[core]) < 1e-9
    assert smallest_dihedral_deg(mesh.nodes_mm, mesh.tets[:, :4]).min() > 4


def test_the_round_rim_of_a_cylinder_is_followed():
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = 8 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(60)])
    vertices = np.vstack([ring - UP, ring + UP, [-UP, UP]])
    k, after = np.arange(60), (np.arange(60) + 1) % 60
    bottom = [np.stack([after, k, np.full(60, 120)], axis=1)]
    side = [np.stack([k, after, after + 60], axis=1), np.stack([k, after + 60, k + 60], axis=1)]
    top = [np.stack([k + 60, after + 60, np.full(60, 121)], axis=1)]
    core = vertices, np.vstack(bottom + side + top)
    mesh = tetrahedralise(*SKIN, *core, edge_mm=6.0)
    assert boundary_gap_mm(mesh, core) < 0.15  # the sagitta of a 6 mm edge on 8 mm is 0.58
    assert mesh.volume_mm3 == pytest.approx(30**3 - enclosed_volume_mm3(*core), rel=2e-3)


def test_elements_are_short_where_the_core_is_sharp_and_nowhere_else():
    core = CORES["cube"]
    mesh = tetrahedralise(*SKIN, *core, edge_mm=6.0)
    corner = mesh.nodes_mm[mesh.tets[:, :4]]
    edge = np.linalg.norm(corner[:, TET_EDGES[:, 0]] - corner[:, TET_EDGES[:, 1]], axis=2).mean(axis=1)
    middle = corner.mean(axis=1)
    gap = np.linalg.norm(creases_of(*core).closest(middle) - middle, axis=1)
    longest = 30 / 8
    assert np.median(edge[gap < 0.5]) < 0.6 * longest
    assert np.median(edge[gap > 6]) > 0.8 * longest
    assert 3 * len(mesh.nodes_mm) < 50_000


def test_creases_of_a_cube_are_its_edges_and_corners_and_a_ball_has_none():
    cube = creases_of(*box((2, 2, 2), cells=3))
    assert np.linalg.norm(cube.along_mm, axis=1).sum() == pytest.approx(12 * 2)
    assert len(cube.corner_mm) == 8
    assert np.abs(np.abs(cube.corner_mm) - 1).max() < 1e-12
    assert np.allclose(cube.closest(np.array([[0.9, 0.8, 0.3]])), [[1, 1, 0.3]])
    assert len(creases_of(*ball(300, semi_axes_mm=(12, 9, 10))).start_mm) == 0


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


def test_a_refined_mesh_holds_the_same_flesh_with_smaller_elements_in_the_contact():
    coarse, touched = fruit_mesh(), square(4, at=(0, 0, 18.0))
    vertices, faces = ball(2000, semi_axes_mm=HALF_AXES_MM)
    vertices[:, 2] = np.maximum(vertices[:, 2], FOOT_MM)
    pit = ball(800, semi_axes_mm=PIT_HALF_AXES_MM, centre_mm=PIT_MIDDLE_MM)
    mesh = flesh_mesh.refined(
        coarse, vertices, faces, *pit, edge_mm=6.0, refine_at_mm=touched, dof_limit=40_000
    )
    assert 3 * len(coarse.nodes_mm) < 3 * len(mesh.nodes_mm) <= 40_000
    assert mesh.volume_mm3 == pytest.approx(coarse.volume_mm3, rel=2e-3)
    near = [
        (np.linalg.norm(each.nodes_mm[each.outer_nodes] - [0, 0, 18], axis=1) < 3).sum()
        for each in (coarse, mesh)
    ]
    assert near[1] > 10 * near[0]


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


def ellipsoid(half_axes_mm, centre_mm=(0.0, 0.0, 0.0)):
    return trimesh.creation.icosphere(subdivisions=4).vertices * half_axes_mm + centre_mm


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
    assert relative_depth(flesh, np.array([[28.9, 0.0, 0.0]])) == pytest.approx(0.0, abs=0.02)


PLACE = np.array([1.0, -1.5, 0.8, np.log(0.8)])


@pytest.fixture(scope="module")
def moved():
    return with_pit_moved(fruit_mesh(), PLACE)


def test_the_pit_is_where_and_as_large_as_asked_in_the_same_skin_and_elements(moved):
    mesh = fruit_mesh()
    before, after = mesh.nodes_mm[mesh.pit_nodes], moved.nodes_mm[moved.pit_nodes]
    middle = before.mean(axis=0)
    np.testing.assert_allclose(after, middle + PLACE[:3] + 0.8 * (before - middle), atol=1e-12)
    np.testing.assert_array_equal(moved.nodes_mm[moved.outer_nodes], mesh.nodes_mm[mesh.outer_nodes])
    np.testing.assert_array_equal(moved.tets, mesh.tets)
    assert t10_jacobians(moved.nodes_mm, moved.tets).min() > 0
    pit_mm3 = t6_volume_mm3(mesh.nodes_mm, mesh.outer_faces) - mesh.volume_mm3
    assert moved.volume_mm3 - mesh.volume_mm3 == pytest.approx((1 - 0.8**3) * pit_mm3, rel=1e-6)


def test_no_move_is_no_move():
    np.testing.assert_array_equal(with_pit_moved(fruit_mesh(), np.zeros(4)).nodes_mm, fruit_mesh().nodes_mm)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ([0, 0, 14.0, 0], r"moves by \(0\.0, 0\.0, 14\.0\) mm and grows to 1\.00"),
        ([0, 0, 0, 1.0], "grows to 2.72"),
    ],
)
def test_a_pit_pushed_through_the_skin_is_refused_with_where_it_should_go(place, said):
    with pytest.raises(FemFailure, match=said) as refused:
        with_pit_moved(fruit_mesh(), np.array(place, dtype=float))
    assert refused.value.problem is FemProblem.INVERTED_ELEMENTS
    assert "Check the pit prior" in refused.value.detail

import numpy as np
import pytest
from fem_shapes import ball, box, smallest_dihedral_deg, star, tetrahedron

from fem.elements.shape_functions import TET_EDGES, TET_FACES
from fem.mesh.closest_point import closest_on_triangles, enclosed_volume_mm3
from fem.mesh.creases import creases_of
from fem.mesh.flesh_mesh import t6_volume_mm3, tetrahedralise
from fem.mesh.tetrahedra import boundary_faces

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

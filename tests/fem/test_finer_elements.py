"""Finer elements under a load, beside Boussinesq's half-space and beside meshes that are fine throughout."""

import numpy as np
import pytest
from fem_shapes import ball, cube_flesh
from injected_mismatch import finders_mesh
from scipy.spatial import cKDTree

from fem.elements.shape_functions import TET_FACES
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import locate
from fem.mesh.tetrahedra import boundary_faces
from fem.solid.finer_elements import FinerElements, finer_elements
from fem.solid.linear_solid import UnitModulusSolid

NU = 0.45
SIDE_MM, CELLS = 24.0, 6
RADIUS_MM = 1.0


def cube() -> FleshMesh:
    return cube_flesh(CELLS, SIDE_MM, uneven=0.1)


def disc(radius_mm: float) -> np.ndarray:
    """Points of equal area on a disc in the middle of the cube's top, off the mesh's lines."""
    k = np.arange(400) + 0.5
    radius, turn = radius_mm * np.sqrt(k / len(k)), np.pi * (1 + np.sqrt(5)) * k
    middle = np.array([SIDE_MM / 2 + 0.3, SIDE_MM / 2 - 0.2, SIDE_MM])
    return middle + np.column_stack([radius * np.cos(turn), radius * np.sin(turn), 0 * k])


def two_discs() -> tuple[np.ndarray, np.ndarray]:
    """1 N down on a disc and 1 N up on one of twice its radius: nothing far away."""
    points = np.vstack([disc(RADIUS_MM), disc(2 * RADIUS_MM)])
    force = np.zeros((1, len(points), 3))
    force[0, :400, 2], force[0, 400:, 2] = -1 / 400, 1 / 400
    return points, force


def corrected(edge_mm: float, reach_mm: float) -> tuple[float, float]:
    """The middle's way down, mm MPa: of the coarse mesh, and what finer elements add."""
    mesh = cube()
    points, force = two_discs()
    moved = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free").displacement(
        locate(mesh, points).point_load(force)
    )
    finer = around(mesh, points, edge_mm, reach_mm)
    added = finer.added((finer.reading(points).T @ force[0])[None], moved)
    middle = disc(0.0)[:1]
    coarse = locate(mesh, middle).sample(moved)[0, 0, 2]
    return -coarse, -float((finer.reading(middle) @ added[0])[0, 2])


def around(mesh: FleshMesh, points: np.ndarray, edge_mm: float, reach_mm: float) -> FinerElements:
    none = np.zeros(0, dtype=np.int64)
    return finer_elements(mesh, points, edge_mm=edge_mm, reach_mm=reach_mm, poisson_ratio=NU, held=none)


def test_under_two_discs_they_give_boussinesqs_answer():
    """The middle under an even pressure moves by 2 (1 - nu^2) F / (pi a E) (Johnson, Contact Mechanics,
    section 3.4).
    """
    truth = 2 * (1 - NU**2) / np.pi * (1 / RADIUS_MM - 1 / (2 * RADIUS_MM))
    coarse, added = corrected(0.4, 6.0)
    assert coarse < 0.7 * truth
    assert coarse + added == pytest.approx(truth, rel=0.02)


def test_the_shorter_their_edges_the_nearer_they_come():
    truth = 2 * (1 - NU**2) / np.pi * (1 / RADIUS_MM - 1 / (2 * RADIUS_MM))
    left = [1 - sum(corrected(edge, 6.0)) / truth for edge in (1.6, 0.8, 0.4)]
    assert left[0] > 1.5 * left[1] > 2.2 * left[2]


def test_elements_farther_away_matter_little():
    near, far = (corrected(0.8, reach)[1] for reach in (5.0, 10.0))
    assert near == pytest.approx(far, rel=0.05)


@pytest.fixture(scope="module")
def curved():
    mesh = tetrahedralise(*ball(800, semi_axes_mm=(12.0, 11.0, 10.0)), None, None, edge_mm=5.0)
    top = mesh.nodes_mm[mesh.outer_nodes]
    return mesh, top[top[:, 2] > 9.0]


def test_the_body_keeps_its_shape_and_quadratic_fields_their_values(curved):
    mesh, points = curved
    finer = around(mesh, points, 1.0, 4.0)
    inside = (np.linalg.norm(mesh.nodes_mm[:, None] - points, axis=2) < 3.0).any(axis=1)
    skin = np.intersect1d(mesh.outer_nodes, np.flatnonzero(inside))
    reading = finer.reading(mesh.nodes_mm[skin])
    np.testing.assert_allclose(reading.sum(axis=1), 1.0)
    np.testing.assert_allclose(reading @ finer.mesh.nodes_mm, mesh.nodes_mm[skin], atol=1e-9)
    anything = np.random.default_rng(0).normal(size=len(mesh.nodes_mm))
    np.testing.assert_allclose(reading @ (finer.from_coarse @ anything), anything[skin], atol=1e-9)
    assert (np.linalg.norm(mesh.nodes_mm[mesh.tets[:, 0]] - points[0], axis=1) > 12).any()
    assert finer.mesh.volume_mm3 < 0.8 * mesh.volume_mm3


def at_the_same_place(finer: FinerElements, places_mm: np.ndarray) -> np.ndarray:
    """Nodes of the finer mesh that lie where any of these do."""
    distance, nearest = cKDTree(finer.mesh.nodes_mm).query(places_mm)
    coincident = nearest[distance < 1e-9]
    assert len(coincident)
    return np.asarray(coincident)


def test_single_nodes_that_a_base_holds_stay(curved):
    """As a base holds a skin's nodes within a distance of it, not whole faces."""
    mesh, points = curved
    near = mesh.outer_nodes[np.linalg.norm(mesh.nodes_mm[mesh.outer_nodes] - points[0], axis=1) < 3.0]
    held = near[::3]
    finer = finer_elements(mesh, points, edge_mm=1.5, reach_mm=4.0, poisson_ratio=NU, held=held)
    assert not np.isin(at_the_same_place(finer, mesh.nodes_mm[held]), finer.free).any()


def test_the_pit_stays():
    mesh = finders_mesh()
    top = mesh.nodes_mm[mesh.outer_nodes]
    points = top[top[:, 2] > np.quantile(top[:, 2], 0.95)]
    finer = around(mesh, points, 4.0, 20.0)
    assert not np.isin(at_the_same_place(finer, mesh.nodes_mm[mesh.pit_nodes]), finer.free).any()


def test_what_is_cut_off_and_what_a_base_holds_stays(curved):
    mesh, points = curved
    held = mesh.outer_nodes[np.linalg.norm(mesh.nodes_mm[mesh.outer_nodes] - points[0], axis=1) < 3.0]
    finer = finer_elements(mesh, points, edge_mm=1.5, reach_mm=4.0, poisson_ratio=NU, held=held)
    n = len(finer.mesh.nodes_mm)
    rng = np.random.default_rng(1)
    added = finer.added(rng.normal(size=(2, n, 3)), np.zeros((2, len(mesh.nodes_mm), 3)))
    still = np.setdiff1d(np.arange(n), finer.free)
    assert np.all(added[:, still] == 0)
    assert not np.isin(at_the_same_place(finer, mesh.nodes_mm[held]), finer.free).any()
    owner, face = boundary_faces(finer.mesh.tets[:, :4])[1].T
    boundary = finer.mesh.tets[owner[:, None], TET_FACES[face]]
    cut = np.setdiff1d(boundary, finer.mesh.outer_faces)
    assert len(cut)
    assert not np.isin(cut, finer.free).any()
    assert np.abs(added[:, finer.free]).min(axis=2).max() > 0
    whole = around(mesh, points, 1.5, 4.0)
    assert len(whole.free) > len(finer.free)


def test_forces_that_the_coarse_mesh_balances_add_nothing(curved):
    mesh, points = curved
    finer = around(mesh, points, 1.5, 4.0)
    moved = np.random.default_rng(2).normal(size=(1, len(mesh.nodes_mm), 3))
    coarse = np.stack([finer.from_coarse @ displacement for displacement in moved])
    force = (finer.stiffness @ coarse.reshape(1, -1).T).T.reshape(coarse.shape)
    np.testing.assert_allclose(finer.added(force, moved), 0.0, atol=1e-9 * np.abs(moved).max())

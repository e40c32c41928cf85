"""Surfaces made closed and few-faced: balls with holes, debris and doubled corners, whose volume is known."""

import numpy as np
import pytest
from refusals import refused

from recon.recon_failure import ReconProblem
from recon.silhouettes.hull import ball
from recon.surface import meshlab
from recon.surface.ray_mesh import RayMesh
from recon.surface.repair import poisson_surface, repaired
from recon.triangle_mesh import bodies, open_edges, volume_mm3

RADIUS_MM = 20.0
pytestmark = pytest.mark.usefixtures("tool")


@pytest.fixture(params=["pymeshlab", "open3d"])
def tool(request, monkeypatch):
    """Both libraries that repair surfaces, each for all tests of this file."""
    if request.param == "open3d":
        monkeypatch.setattr(meshlab, "library", lambda: None)


BALL_MM3 = 4 / 3 * np.pi * RADIUS_MM**3


def ball_mesh(level: int = 4) -> tuple[np.ndarray, np.ndarray]:
    directions, faces = ball(level)
    return RADIUS_MM * directions, faces


def without_cap(vertices: np.ndarray, faces: np.ndarray, *, half_angle_deg: float) -> np.ndarray:
    """The faces but those of a cap about +z."""
    away = np.cos(np.radians(half_angle_deg)) * RADIUS_MM
    return faces[~(vertices[faces, 2] > away).all(axis=1)]


def test_a_hole_cut_into_a_ball_is_closed_to_the_balls_volume_less_the_caps():
    """A flat lid over a cap of half angle a takes pi h² (3 r - h) / 3 away, h = r (1 - cos a)."""
    vertices, faces = ball_mesh()
    cut = without_cap(vertices, faces, half_angle_deg=20.0)
    height = RADIUS_MM * (1 - np.cos(np.radians(20.0)))
    cap = np.pi * height**2 * (3 * RADIUS_MM - height) / 3
    mesh = repaired(vertices, cut, max_faces=100_000)
    assert open_edges(cut) > 0
    assert open_edges(mesh.faces) == 0
    whole = volume_mm3(vertices, faces)
    assert whole - 1.1 * cap < volume_mm3(mesh.vertices, mesh.faces) < whole + 1e-6
    assert mesh.deviation_rms_mm < 1e-4


def turned_here_and_there(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[::7, ::-1], np.delete(faces, np.s_[::7], axis=0)])


@pytest.mark.parametrize(
    "change",
    [np.array, lambda faces: faces[:, ::-1], turned_here_and_there],
    ids=["whole", "inside out", "mixed"],
)
def test_a_ball_comes_back_as_it_was_whichever_way_its_faces_look(change):
    vertices, faces = ball_mesh(3)
    mesh = repaired(vertices, change(faces), max_faces=len(faces))
    assert len(mesh.faces) == len(faces)
    assert open_edges(mesh.faces) == 0
    assert volume_mm3(mesh.vertices, mesh.faces) == pytest.approx(volume_mm3(vertices, faces), rel=1e-5)


def test_few_faces_are_kept_and_how_far_they_moved_the_surface_is_told():
    vertices, faces = ball_mesh()
    mesh = repaired(vertices, faces, max_faces=1000)
    assert 900 <= len(mesh.faces) <= 1000
    assert open_edges(mesh.faces) == 0
    assert volume_mm3(mesh.vertices, mesh.faces) == pytest.approx(BALL_MM3, rel=0.01)
    away = RayMesh(mesh.vertices, mesh.faces).distances_mm(vertices)
    assert mesh.deviation_rms_mm == pytest.approx(np.sqrt(np.mean(away**2)), rel=0.05)
    # a chord of a circle of radius r and length a lies a² / 8 r under it; 1000 even faces have a = 2.4 mm
    assert 0.01 < away.max() < 0.3


def test_a_cherry_is_decimated_as_well_as_a_peach():
    directions, faces = ball(4)
    away = [repaired(r * directions, faces, max_faces=1000).deviation_rms_mm / r for r in (4.0, 40.0)]
    assert away[0] == pytest.approx(away[1], rel=0.1)


def test_debris_and_doubled_faces_and_corners_are_removed():
    vertices, faces = ball_mesh(3)
    speck, triangles = ball(0)
    soup = vertices[faces].reshape(-1, 3)  # no two faces share a corner
    both = np.concatenate([soup, 0.5 * speck + [30.0, 0.0, 0.0]])
    loose = np.concatenate(
        [np.arange(len(soup)).reshape(-1, 3), np.arange(30).reshape(-1, 3), triangles + len(soup)]
    )
    mesh = repaired(both, loose, max_faces=len(faces))
    assert len(mesh.vertices) == len(vertices)
    assert (open_edges(mesh.faces), bodies(mesh.faces)) == (0, 1)
    assert mesh.vertices[:, 0].max() < RADIUS_MM + 1e-4


def test_what_stays_open_is_refused():
    """A cone whose rim has more edges than a hole that is closed."""
    turn = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    rim = RADIUS_MM * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(500)])
    vertices = np.concatenate([rim, [[0.0, 0.0, RADIUS_MM]]])
    k = np.arange(500)
    faces = np.column_stack([k, (k + 1) % 500, np.full(500, 500)])
    with refused(ReconProblem.NOT_WATERTIGHT, "still has 500 open edges"):
        repaired(vertices, faces, max_faces=10_000)


def test_a_surface_through_points_of_a_ball_is_the_ball_though_they_are_noisy():
    directions, _ = ball(5)
    noisy = directions * (RADIUS_MM + np.random.default_rng(4).normal(0, 0.1, (len(directions), 1)))
    vertices, faces = poisson_surface(noisy, directions)
    away = np.linalg.norm(vertices, axis=1) - RADIUS_MM
    assert open_edges(faces) == 0
    assert np.abs(away).max() < 0.25
    assert np.sqrt(np.mean(away**2)) < 0.05  # half the points' own noise
    again, _ = poisson_surface(noisy, directions)
    np.testing.assert_array_equal(again, vertices)

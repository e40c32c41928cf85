"""The gel's load on the skin: total force, place and moment of a pressure whose integral is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from fem.solid.gel_traction import GelField, GelFrame, MarkerGrid, nodal_force

RADIUS_MM, PEAK_MPA, KT = 5.3, 0.2, 0.055


def grid(pitch_mm: float, half_mm: float = 10.0) -> np.ndarray:
    line = np.arange(-half_mm, half_mm + pitch_mm / 2, pitch_mm) + 0.13 * pitch_mm
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)


def pressure(places: np.ndarray) -> np.ndarray:
    """A paraboloid: on springs a ball presses so. Its integral is pi a^2 p / 2."""
    return PEAK_MPA * np.maximum(1 - (places**2).sum(axis=1) / RADIUS_MM**2, 0)


def gel(rest_mm: np.ndarray, cell_mm2: float, shear=(0.0, 0.0)) -> GelFrame:
    on = pressure(rest_mm) > 0
    force = np.column_stack([np.zeros((len(rest_mm), 2)), pressure(rest_mm)]) * cell_mm2
    moved = on[:, None] * np.array(shear)
    force[:, :2] = KT * moved * cell_mm2
    return GelFrame(grid=MarkerGrid.of(rest_mm), shear_mm=moved, force_N=force, touching=on)


def flat_skin(edge_mm: float, way=(0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """A plane of T6 faces that look towards the pad (-z), moved by `way`."""
    corners = grid(edge_mm, 9.0)
    triangles = Delaunay(corners).simplices
    middles = (corners[triangles] + corners[np.roll(triangles, -1, axis=1)]) / 2
    nodes = np.vstack([corners, middles.reshape(-1, 2)])
    faces = np.column_stack([triangles, len(corners) + np.arange(middles.size // 2).reshape(-1, 3)])
    faces = faces[:, [0, 2, 1, 5, 4, 3]]
    return np.column_stack([nodes + np.array(way), np.zeros(len(nodes))]), faces


def load(frame: GelFrame, nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    field = GelField.of(frame)
    assert field is not None
    return nodal_force(field, nodes, faces)


@pytest.mark.parametrize("edge_mm", [0.8, 2.1])
def test_the_total_is_that_of_the_markers_and_lies_where_the_pressure_does(edge_mm):
    frame = gel(grid(1.0), 1.0)
    nodes, faces = flat_skin(edge_mm)
    force = load(frame, nodes, faces)[:, 2]
    assert force.sum() == pytest.approx(frame.force_N[:, 2].sum(), rel=1e-9)
    second = (force[:, None] * nodes[:, :2] ** 2).sum(axis=0) / force.sum()
    assert second == pytest.approx(RADIUS_MM**2 / 6, rel=0.01)


def test_twice_the_markers_bring_a_third_of_the_error_at_most():
    """Of the second moment, which an overshoot at the rim would change."""
    nodes, faces = flat_skin(0.8)
    off = []
    for pitch in (2.0, 1.0):
        force = load(gel(grid(pitch), pitch**2), nodes, faces)[:, 2]
        moment = (force * (nodes[:, :2] ** 2).sum(axis=1)).sum() / force.sum()
        off.append(abs(moment / (RADIUS_MM**2 / 3) - 1))
    assert off[1] < off[0] / 3


def test_the_load_acts_where_shear_has_moved_the_gel():
    """Skin and gel moved aside together: the same forces on the same nodes."""
    way = (0.31, -0.22)
    still = load(gel(grid(1.0), 1.0), *flat_skin(1.3))
    moved = load(gel(grid(1.0), 1.0, shear=way), *flat_skin(1.3, way))
    assert np.abs(moved[:, 2] - still[:, 2]).max() < 2e-3 * still[:, 2].max()
    shear_N = moved[:, :2].sum(axis=0)
    assert shear_N == pytest.approx(KT * np.pi * RADIUS_MM**2 * np.array(way), rel=0.06)


def test_the_far_side_of_the_fruit_is_not_loaded():
    nodes, faces = flat_skin(1.3)
    behind = faces[:, [0, 2, 1, 5, 4, 3]]
    both = np.vstack([nodes, nodes + np.array([0, 0, 40])])
    force = load(gel(grid(1.0), 1.0), both, np.vstack([faces, behind + len(nodes)]))
    assert not force[len(nodes) :].any()
    assert force[: len(nodes), 2].sum() > 0


def test_a_rim_that_sticks_pulls():
    """Springs that hold on up to a ring of tension: the total is that of both parts."""
    rest = grid(0.5)
    r2 = (rest**2).sum(axis=1)
    normal = np.where(r2 < 7.1**2, PEAK_MPA * (1 - r2 / RADIUS_MM**2), 0.0)
    frame = GelFrame(
        grid=MarkerGrid.of(rest),
        shear_mm=np.zeros((len(rest), 2)),
        force_N=np.column_stack([np.zeros((len(rest), 2)), normal]) * 0.25,
        touching=r2 < 7.1**2,
    )
    force = load(frame, *flat_skin(0.8))[:, 2]
    assert force[force < 0].sum() == pytest.approx(frame.force_N[frame.force_N[:, 2] < 0, 2].sum(), rel=0.1)
    assert force.sum() == pytest.approx(frame.force_N[:, 2].sum(), abs=0.03 * force[force > 0].sum())


@pytest.mark.parametrize("pitch", [1.0, 0.6])
def test_a_contact_that_reaches_the_border_of_the_grid_ends_with_it(pitch):
    """A flat pad whose pressure grows towards its edge: nothing is added beyond."""
    line = (np.arange(-4, 4.5) * 2 + 0) * pitch / 2
    rest = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    normal = PEAK_MPA * (1 + (rest**2).sum(axis=1) / 20) * pitch**2
    frame = GelFrame(
        grid=MarkerGrid.of(rest),
        shear_mm=np.zeros((len(rest), 2)),
        force_N=np.column_stack([np.zeros((len(rest), 2)), normal]),
        touching=np.ones(len(rest), dtype=bool),
    )
    nodes, faces = flat_skin(0.8)
    force = load(frame, nodes, faces)[:, 2]
    assert force.sum() == pytest.approx(normal.sum(), rel=1e-9)
    beyond = np.abs(nodes[:, :2]).max(axis=1) > np.abs(rest).max() + 0.8
    assert not force[beyond].any()


def test_few_markers_load_the_skin_with_about_their_force():
    rest = grid(1.0)
    on = np.linalg.norm(rest - rest[len(rest) // 2], axis=1) < 1.1  # five of them
    force = np.zeros((len(rest), 3))
    force[on, 2] = 0.05
    frame = GelFrame(grid=MarkerGrid.of(rest), shear_mm=np.zeros((len(rest), 2)), force_N=force, touching=on)
    assert load(frame, *flat_skin(0.8))[:, 2].sum() == pytest.approx(0.25, rel=0.1)


def test_the_force_of_a_rim_that_noise_hides_is_kept():
    frame = gel(grid(1.0), 1.0)
    hidden = frame.force_N[:, 2] < 0.3 * PEAK_MPA
    force = load(replace(frame, touching=frame.touching & ~hidden), *flat_skin(0.8))[:, 2]
    assert force.sum() == pytest.approx(frame.force_N[:, 2].sum(), rel=1e-9)


def test_noise_of_markers_far_from_the_contact_loads_nothing():
    frame = gel(grid(1.0), 1.0)
    noisy = frame.force_N.copy()
    at = frame.grid.rest_mm[frame.touching]
    away_mm = np.linalg.norm(frame.grid.rest_mm[:, None] - at, axis=2).min(axis=1)
    far = away_mm > 2.0  # pitches of 1 mm
    assert far.sum() > 20
    noisy[far] += 0.02 * PEAK_MPA
    same, quiet = (load(pad, *flat_skin(0.8)) for pad in (replace(frame, force_N=noisy), frame))
    np.testing.assert_array_equal(same, quiet)

"""A modulus injected by another discretisation is found again, with an honest error bar."""

from dataclasses import replace

import numpy as np
import pytest
from injected_recording import (
    BOTH,
    BUDGET,
    E_MPA,
    HEIGHT_MM,
    PHASES,
    PUCK,
    RADII_MM,
    RADIUS_MM,
    found_in,
    grasp,
    own_model,
    own_sd_MPa,
    plain_model,
    recorded,
    solid_of,
    with_pads,
)

from fem.estimation.error_budget import TACTILE
from fem.estimation.frame_thinning import MOST_FRAMES, spacing, thinned
from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import tetrahedralise


def puck_surface(n: int = 72) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder's surface: rings on bottom, wall and top."""
    across = np.linspace(0, RADIUS_MM, 13)[1:]
    up = np.linspace(0, HEIGHT_MM, 10)
    profile = [(r, 0.0) for r in across] + [(RADIUS_MM, z) for z in up[1:-1]]
    profile += [(r, HEIGHT_MM) for r in across[::-1]]
    turn = 2 * np.pi * np.arange(n) / n
    rings = [np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(n, z)]) for r, z in profile]
    vertices = np.vstack([*rings, [[0, 0, 0], [0, 0, HEIGHT_MM]]])
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    faces = [np.column_stack([j, i, np.full(n, len(vertices) - 2)])]
    for k in range(len(profile) - 1):
        a, b = k * n, (k + 1) * n
        faces += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    last = (len(profile) - 1) * n
    faces += [np.column_stack([last + i, last + j, np.full(n, len(vertices) - 1)])]
    return vertices, np.vstack(faces)


@pytest.mark.slow
def test_a_grasp_gives_the_injected_modulus_both_ways():
    estimate = found_in(grasp(noise=0.5), own_model(0.5))
    assert estimate.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert estimate.energy.E_MPa == pytest.approx(E_MPA, rel=0.01)
    assert estimate.warnings == ()


@pytest.mark.slow
def test_a_press_on_a_base_gives_the_injected_modulus():
    mesh = tetrahedralise(
        *puck_surface(),
        None,
        None,
        edge_mm=6.0,
        refine_at_mm=np.array([[0, 0, HEIGHT_MM]]),
        refine_radius_mm=7.0,
        refine_edge_mm=2.0,
    )
    history = recorded(PUCK, BOTH[:1], np.random.default_rng(0), moves=False)
    model = grasp_model(history, solid_of(mesh, history, support="base"))
    estimate = estimate_modulus(history, model, budget=BUDGET)
    assert estimate.E_MPa == pytest.approx(E_MPA, rel=0.015)
    assert estimate.energy.E_MPa == pytest.approx(E_MPA, rel=0.015)


def test_the_error_bar_covers_the_truth():
    estimates = [found_in(grasp(s), plain_model()) for s in range(8)]
    sd_MPa = np.array([own_sd_MPa(f) for f in estimates])
    values = np.array([f.E_MPa for f in estimates])
    assert (np.abs(values - E_MPA) < 2 * np.array([f.E_sd_MPa for f in estimates])).all()
    assert 0.3 < np.std(values) / sd_MPa.mean() < 1.5
    assert np.abs(np.array([f.energy.E_MPa for f in estimates]) - E_MPA).max() < 0.02 * E_MPA


def test_every_frame_and_pad_has_its_own_modulus():
    estimate = found_in(grasp(noise=0.1), plain_model())
    assert {f.pad for f in estimate.frames} == {"all", "left", "right"}
    assert len(estimate.frames) == 3 * len(RADII_MM)
    heavy = [f for f in estimate.frames if RADII_MM[f.frame] >= 4]
    assert np.array([f.E_MPa for f in heavy]) == pytest.approx(E_MPA, rel=0.02)
    assert [f.phase for f in estimate.frames if f.pad == "all"] == list(PHASES)


def test_twice_the_force_is_twice_the_modulus():
    history = grasp()
    stiff = with_pads(history, force_N=lambda pad: 2 * pad.force_N)
    a, b = found_in(history, plain_model()), found_in(stiff, plain_model())
    assert b.E_MPa == pytest.approx(2 * a.E_MPa, rel=1e-9)


@pytest.mark.slow
def test_misfit_that_neighbours_share_widens_the_tactile_part():
    rng = np.random.default_rng(5)
    plain = grasp(noise=0.5)

    def bent(pad):
        block = np.floor(pad.rest_mm[:, :2] / 4.0).astype(int)
        number = np.unique(block, axis=0, return_inverse=True)[1].reshape(-1)
        amount = 0.010 * rng.normal(size=(number.max() + 1, 3))[number]
        load = np.linalg.norm(pad.force_N.sum(axis=1), axis=1)
        return pad.position_mm + (load / load.max())[:, None, None] * amount

    model = own_model(0.5)  # of forces, which are the same
    straight = found_in(plain, model).parts_sd_MPa[TACTILE]
    assert found_in(with_pads(plain, position_mm=bent), model).parts_sd_MPa[TACTILE] > 2 * straight


def stretched(history: GraspHistory, frames: int) -> GraspHistory:
    """The same press recorded with more frames, linear between those that there are."""
    at = np.linspace(0, len(RADII_MM) - 1, frames)
    before, share = np.minimum(at.astype(int), len(RADII_MM) - 2), at % 1
    share[-1] = 1.0

    def between(values):
        return values[before] + share[:, None, None] * (values[before + 1] - values[before])

    long = with_pads(
        history,
        position_mm=lambda pad: between(pad.position_mm),
        gel_displacement_mm=lambda pad: between(pad.gel_displacement_mm),
        force_N=lambda pad: between(pad.force_N),
        episode=lambda pad: np.minimum(pad.episode[before], pad.episode[before + 1]),
        lag1=0.9,
    )
    return replace(long, time_s=np.arange(frames) / 30, phase=tuple(PHASES[b] for b in before))


def test_a_long_recording_is_thinned_evenly():
    frames = 450
    estimate = found_in(stretched(grasp(noise=0.5), frames))
    used = np.flatnonzero(estimate.loaded)
    assert len(used) == MOST_FRAMES
    assert (used[0], used[-1]) == (0, frames - 1)
    assert set(np.diff(used)) == {3, 4}
    assert {frame.frame for frame in estimate.frames} == set(used)
    assert estimate.residual_mm.shape[0] == MOST_FRAMES
    assert estimate.E_MPa == pytest.approx(E_MPA, rel=0.01)


def test_few_frames_are_all_used():
    loaded = np.arange(300) % 3 == 0
    np.testing.assert_array_equal(thinned(loaded), loaded)
    assert spacing(loaded) == 3.0
    assert spacing(np.arange(5) == 2) == 1.0

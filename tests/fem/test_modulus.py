"""A modulus injected by another discretisation is found again, with an honest error bar, or is refused.

Truth and estimate are solved on different meshes (drawn_grasps); benchmarks/calibration.py has the other
causes.
"""

from dataclasses import replace

import numpy as np
import pytest
from drawn_grasps import Fruit, Off, Sensor, World
from drawn_inference import Estimator
from injected_recording import (
    BOTH,
    BUDGET,
    E_MPA,
    HEIGHT_MM,
    PHASES,
    PUCK,
    RADII_MM,
    RADIUS_MM,
    ball_mesh,
    found_in,
    grasp,
    own_model,
    own_sd_MPa,
    plain_model,
    recorded,
    solid_of,
    with_pads,
)
from refusals import refused

from fem.estimation.error_budget import TACTILE, ErrorBudget
from fem.estimation.frame_thinning import MOST_FRAMES, spacing, thinned
from fem.estimation.grasp_model import grasp_model
from fem.estimation.live_modulus import FEWEST, FirstTouch, LiveModel, frame_modulus
from fem.estimation.modulus import FEWEST_MARKERS, ModulusSign, estimate_modulus
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.pad_link import OFF_SKIN_MM, contact_nodes
from fem.solid.traction import marker_weights, moment_correction


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


AIR = {"episode": lambda pad: 0 * pad.episode - 1}


@pytest.mark.parametrize(
    ("changed", "modelled", "problem", "words"),
    [
        ({"force_N": lambda pad: -pad.force_N}, True, FemProblem.NO_MODULUS, "Check the signs"),
        (AIR, True, FemProblem.NO_LOAD, None),
        (AIR, False, FemProblem.NO_LOAD, None),
        ({"force_N": lambda pad: 0 * pad.force_N}, False, FemProblem.NO_LOAD, "found no force"),
    ],
    ids=["forces that pull", "no touch", "no touch has no model", "no force has no model"],
)
def test_a_grasp_that_shows_no_modulus_is_refused(changed, modelled, problem, words):
    with refused(problem, words):
        found_in(with_pads(grasp(), **changed), plain_model() if modelled else None)


def only_touching(history, count):
    """The `count` markers of the first pad that touch longest stay in contact; no other ever is."""
    longest = np.argsort(-(history.pads[0].episode >= 0).sum(axis=0), kind="stable")[:count]
    chosen = np.isin(np.arange(len(history.pads[0].rest_mm)), longest)
    first = history.pads[0].name
    return with_pads(history, episode=lambda pad: np.where(chosen & (pad.name == first), pad.episode, -1))


def test_fewer_markers_than_hold_a_fruit_are_refused_and_counted():
    few = only_touching(grasp(), FEWEST_MARKERS - 1)
    with pytest.raises(FemFailure, match=r"found 5 markers under load, expected at least 6") as caught:
        found_in(few, plain_model())
    assert caught.value.problem is FemProblem.TOO_FEW_MARKERS
    assert "Press deeper" in caught.value.detail
    assert found_in(only_touching(grasp(), FEWEST_MARKERS), plain_model()).E_MPa > 0


def test_a_pad_off_the_mesh_is_refused_with_how_far_it_is():
    off = OFF_SKIN_MM + 1.5
    away = with_pads(grasp(), surface_mm=lambda pad: pad.surface_mm * (1 + off / 25.0))
    for call in (lambda: contact_nodes(ball_mesh(), [away]), lambda: found_in(away)):
        with refused(FemProblem.OFF_SURFACE, r"the worst .*4\.[45]\d mm.*Check the pad's pose"):
            call()


def test_a_gain_of_one_pad_is_said():
    uneven = with_pads(grasp(), force_N=lambda pad: (1.15 if pad.name == "left" else 1.0) * pad.force_N)
    estimate = found_in(uneven, plain_model())
    assert any(warning.sign is ModulusSign.UNBALANCED for warning in estimate.warnings)


def test_a_lag_of_the_forces_is_said_and_widens_the_error_bar():
    history = grasp()
    late = with_pads(history, force_N=lambda pad: np.concatenate([pad.force_N[:1], pad.force_N[:-1]]))
    plain, lagging = found_in(history, plain_model()), found_in(late, plain_model())
    assert lagging.warnings
    assert own_sd_MPa(lagging) > 3 * own_sd_MPa(plain)


def test_frames_that_share_no_marker_are_refused():
    history = grasp(noise=0.1, surface_mm=0.0)

    def apart(pad):
        even = np.arange(len(pad.rest_mm)) % 2 == 0
        episode = np.full(pad.episode.shape, -1)
        episode[4, even & (pad.episode[4] >= 0)] = 0
        episode[5, ~even & (pad.episode[5] >= 0)] = 0
        return episode

    with refused(FemProblem.TOO_FEW_MARKERS, "found 0 markers that stay in contact for two frames"):
        found_in(with_pads(history, episode=apart), plain_model())


def test_a_pad_seen_in_one_frame_only_leaves_the_other_its_say():
    def once(pad):
        last = np.arange(len(pad.episode))[:, None] == 5
        return np.where(last | (pad.name == "left"), pad.episode, -1)

    assert found_in(with_pads(grasp(noise=0.1), episode=once)).E_MPa == pytest.approx(E_MPA, rel=0.05)


N = 60


@pytest.fixture(scope="module")
def live() -> LiveModel:
    """A made-up, symmetric compliance of markers on two patches, and their rigid motions."""
    rng = np.random.default_rng(3)
    place = rng.uniform(-6, 6, (N, 3)) + np.where(np.arange(N)[:, None] % 2, 25.0, -25.0) * [0, 0, 1]
    near = np.exp(-np.linalg.norm(place[:, None] - place, axis=2) / 5)
    arm = place - place.mean(axis=0)
    turn = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2) / 25
    rigid = np.concatenate([np.tile(np.eye(3), (N, 1, 1)), turn], axis=2).reshape(-1, 6)
    return LiveModel(compliance=np.kron(near, np.eye(3)).astype(np.float32), rigid=rigid, fruit_moves=True)


def frames(live, rng, *, noise_mm=0.0, steps=8):
    """Places, forces and touches of a press in which markers join one after another."""
    joins = np.sort(rng.integers(0, 4, N))
    force = np.zeros((steps, N, 3))
    touching = np.arange(steps)[:, None] >= joins
    load = np.linspace(0.1, 1.0, steps)[:, None] * touching
    force[:, :, 2] = 0.05 * load * rng.uniform(0.5, 1.5, N)
    moved = (live.compliance @ force.reshape(steps, -1).T).T.reshape(steps, N, 3) / E_MPA
    motion = np.cumsum(rng.normal(0, 0.05, (steps, 6)), axis=0)
    place = rng.normal(0, 20, (N, 3)) + moved + (live.rigid @ motion.T).T.reshape(steps, N, 3)
    return place + noise_mm * rng.normal(size=place.shape), force, touching


def run(live, place, force, touching, sd_mm):
    before, estimates = FirstTouch.none(N), []
    for t in range(len(place)):
        estimate, before = frame_modulus(
            live, before, position_mm=place[t], force_N=force[t], touching=touching[t], sd_mm=sd_mm
        )
        estimates.append(estimate)
    return estimates


def test_every_frame_after_the_first_gives_the_injected_modulus(live):
    place, force, touching = frames(live, np.random.default_rng(0))
    estimates = run(live, place, force, touching, 1e-3)
    assert np.isnan(estimates[0].E_MPa)
    assert np.array([estimate.E_MPa for estimate in estimates[1:]]) == pytest.approx(E_MPA, rel=2e-3)
    assert np.nanmax(np.abs(estimates[-1].residual_mm)) < 1e-4
    assert np.isnan(estimates[2].residual_mm[~touching[1] | ~touching[2]]).all()


def test_its_error_bar_covers_the_truth(live):
    scores = []
    for seed in range(60):
        data = frames(live, np.random.default_rng(seed), noise_mm=0.002)
        last = run(live, *data, 0.002)[-1]
        scores.append((1 / last.E_MPa - 1 / E_MPA) * last.E_MPa**2 / last.E_sd_MPa)
    assert 0.75 < np.std(scores) < 1.3


def test_a_marker_that_lets_go_is_compared_with_its_next_touch(live):
    place, force, touching = frames(live, np.random.default_rng(1))
    touching[4, ::2] = False
    place[5:, ::2] += 3.0  # it has been put down elsewhere
    estimates = run(live, place, force, touching, 1e-3)
    assert np.isnan(estimates[5].residual_mm[::2]).all()
    assert estimates[-1].E_MPa == pytest.approx(E_MPA, rel=2e-3)


def test_too_few_markers_give_nothing(live):
    place, force, touching = frames(live, np.random.default_rng(2))
    touching[:, FEWEST - 1 :] = False
    assert all(np.isnan(estimate.E_MPa) for estimate in run(live, place, force, touching, 1e-3))


def grid(half: float = 6.0, step: float = 1.0):
    axis = np.arange(-half, half + step / 2, step)
    flat = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack([flat, np.zeros(len(flat))])


def on_ball(flat: np.ndarray, radius_mm: float = 20.0) -> np.ndarray:
    return np.column_stack([flat[:, :2], np.sqrt(radius_mm**2 - (flat[:, :2] ** 2).sum(axis=1))])


def on_a_ball():
    """Markers, the points that carry their traction, and its weights."""
    markers = on_ball(grid())
    between, weights = marker_weights(grid(), markers)
    return markers, on_ball(between), weights


def resultant(points, force):
    return np.hstack([force.sum(axis=1), np.cross(points, force).sum(axis=1)])


def test_total_force_and_moment_are_kept_by_a_small_correction():
    markers, points, weights = on_a_ball()
    force = np.random.default_rng(1).normal(size=(1, len(markers), 3))
    rigid, balance = moment_correction(points, markers, weights)
    plain = (weights @ force[0])[None]
    more = (rigid @ (balance @ force.ravel())).reshape(plain.shape)
    before, after = resultant(markers, force), resultant(points, plain + more)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-9 * np.abs(before).max())
    assert np.abs(more).max() < 0.01 * np.abs(plain).max()


def test_a_curved_traction_has_its_second_moment():
    """Plain interpolation would make the bowl a sixth of a cell too wide in its square."""
    rest = grid(9.0)
    between, weights = marker_weights(rest, rest)
    bowl = np.maximum(1 - (rest**2).sum(axis=1) / 49, 0.0) ** 3
    total, second = bowl.sum(), bowl @ rest[:, 0] ** 2
    assert (weights @ bowl) @ between[:, 0] ** 2 == pytest.approx(second, rel=1e-9)
    assert (weights @ bowl).sum() == pytest.approx(total, rel=1e-12)


def test_every_force_is_spread_whole_and_an_even_traction_stays_even_away_from_the_rim():
    rest = grid()
    between, weights = marker_weights(rest, rest)
    np.testing.assert_allclose(np.asarray(weights.sum(axis=0)).ravel(), 1.0, atol=1e-12)
    spread = weights @ np.ones(len(rest))
    inner = (np.abs(between[:, :2]) < 4.5).all(axis=1)
    np.testing.assert_allclose(spread[inner], spread[inner][0], rtol=1e-12)


def test_a_linear_traction_has_its_moment_without_correction_inside():
    rest = grid()
    between, weights = marker_weights(rest, rest)
    force = np.where((np.abs(rest[:, :2]) < 4.5).all(axis=1), 1 + 0.1 * rest[:, 0], 0.0)
    assert between[:, 0] @ (weights @ force) == pytest.approx(rest[:, 0] @ force, rel=1e-9)


@pytest.mark.parametrize("rest", [np.zeros((1, 3)), np.eye(3)[:2], np.column_stack([np.arange(5.0)] * 3)])
def test_markers_that_span_no_area_carry_their_own_force(rest):
    between, weights = marker_weights(rest, rest)
    np.testing.assert_allclose(between, rest)
    np.testing.assert_allclose(weights.toarray(), np.eye(len(rest)))


def test_separate_patches_are_not_bridged():
    rest = np.vstack([grid(2.0), grid(2.0) + np.array([15.0, 0, 0])])
    between, _ = marker_weights(rest, rest)
    assert not ((between[:, 0] > 2.5) & (between[:, 0] < 12.5)).any()


SIZES = {"edge_mm": 9.0, "refine_edge_mm": 5.0}
SILENT = Sensor(displacement_mm=0.0, force_N=0.0, gel_scale=0.0, force_scale=0.0)
DRAWS = 12


@pytest.mark.slow
def test_noise_of_force_and_displacement_moves_the_modulus_as_stated():
    rng = np.random.default_rng(4)
    world = World.of(Fruit.drawn(rng), np.array([[0.2, 1, 0.1], [1, -0.2, 0.15]]), **SIZES)
    estimator, truths = Estimator.of(world, **SIZES), world.solved(Off())

    def alone(sensor):
        return estimator.alone(truths, E_MPa=0.5, rng=rng, budget=ErrorBudget(), sensor=sensor)

    usual_MPa = [estimate.E_MPa for estimate in alone(SILENT)]
    drawn = [alone(Sensor()) for _ in range(DRAWS)]
    change = [[np.log(each.E_MPa / E) for each, E in zip(row, usual_MPa, strict=True)] for row in drawn]
    stated = [[own_sd_MPa(each) / each.E_MPa for each in row] for row in drawn]
    error = np.sqrt(np.mean(np.square(change)) / np.mean(np.square(stated)))
    assert 0.6 < error < 1.6

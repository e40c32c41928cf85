"""One frame gives the injected modulus, from the first touches on, whatever the fruit's motion."""

import numpy as np
import pytest
from injected_recording import E_MPA

from fem.estimation.live_modulus import FEWEST, FirstTouch, LiveModel, frame_modulus

N = 60


@pytest.fixture(scope="module")
def live() -> LiveModel:
    """A made-up, symmetric compliance of markers on two patches, and their rigid motions."""
    rng = np.random.default_rng(3)
    place = rng.uniform(-6, 6, (N, 3)) + np.where(np.arange(N)[:, None] % 2, 25.0, -25.0) * [0, 0, 1]
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    near = np.exp(-apart / 5)
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

import numpy as np
import pytest

from tactile.trace_thinning import BOUND, MOST_FRAMES, thin


def drawn(time_s, *, ramp_s, start_s, noise_N, rng, fall_s=None):
    """A press of 3 mm in `ramp_s`, held: Hertz's d^1.5, relaxing by half (20 s); force lost at `fall_s`."""
    travel = 3 * np.clip((time_s - start_s) / ramp_s, 0, 1)
    force = travel**1.5 * (0.5 + 0.5 * np.exp(-np.maximum(time_s - start_s - ramp_s, 0) / 20))
    if fall_s is not None:
        force = np.where(time_s > fall_s, 0.4 * force, force)
    return travel, force, force + noise_N * rng.standard_normal(len(time_s))


@pytest.mark.parametrize(("ramp_s", "frames"), [(0.3, 40_000), (60.0, 24_000), (300.0, 100_000)])
def test_a_thinned_trace_keeps_its_ramp_and_its_hold_within_the_bound_that_it_states(ramp_s, frames):
    rng = np.random.default_rng(1)
    time = np.linspace(0, 400, frames)
    travel, true, force = drawn(time, ramp_s=ramp_s, start_s=20.0, noise_N=0.01, rng=rng)
    found = thin(time, travel, force)
    kept = found.kept
    assert found.noise_N == pytest.approx(0.01, rel=0.05)
    assert 250 < len(kept) <= 1000
    assert found.off < 1.6 * BOUND
    assert kept[0] == 0
    assert kept[-1] == frames - 1
    off = np.abs(np.interp(time, time[kept], force[kept]) - true)
    assert np.sqrt(np.mean(off**2)) < 1.1 * 0.01
    ramp = (time[kept] > 20) & (time[kept] < 20 + ramp_s)
    assert ramp.sum() > min(60, 0.5 * ramp_s * frames / 400)
    assert (time[kept] < 20).sum() > 8
    assert (time[kept] > 350).sum() > 8
    assert "drupe thinned" in found.said("t.csv")


@pytest.mark.parametrize(("step_N", "noise_N"), [(0.01, 0.0), (0.1, 0.01)])
def test_a_force_that_is_rounded_has_the_noise_of_its_steps(step_N, noise_N):
    rng = np.random.default_rng(4)
    time = np.linspace(0, 400, 40_000)
    travel, _, force = drawn(time, ramp_s=60.0, start_s=20.0, noise_N=noise_N, rng=rng)
    found = thin(time, travel, np.round(force / step_N) * step_N)
    assert found.noise_N == pytest.approx(step_N / 12**0.5, rel=0.3)
    assert found.off < 3 * BOUND


def test_a_sudden_fall_is_kept_to_the_frame():
    rng = np.random.default_rng(2)
    time = np.linspace(0, 100, 30_000)
    travel, _, force = drawn(time, ramp_s=90.0, start_s=2.0, noise_N=0.01, rng=rng, fall_s=71.3)
    kept = thin(time, travel, force).kept
    before, after = kept[time[kept] <= 71.3][-1], kept[time[kept] > 71.3][0]
    assert time[after] - time[before] < 0.05
    assert force[after] < 0.5 * force[before]


def test_frames_that_are_kept_are_no_choice_of_their_noise():
    rng = np.random.default_rng(3)
    time = np.linspace(0, 400, 40_000)
    travel, true, force = drawn(time, ramp_s=60.0, start_s=20.0, noise_N=0.01, rng=rng)
    kept = thin(time, travel, force).kept
    noise = (force - true)[kept]
    assert noise.std() == pytest.approx(0.01, rel=0.12)
    assert abs(noise.mean()) < 4 * 0.01 / np.sqrt(len(kept))


def test_a_trace_of_a_usual_length_is_left_as_it_is():
    time = np.linspace(0, 10, MOST_FRAMES)
    assert thin(time, time, time**1.5) is None

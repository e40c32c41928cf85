"""Forces of a gel: springs give A d, what is beyond them stays, gels that are none are left alone."""

from dataclasses import replace

import numpy as np
import pytest
from injected_mismatch import FLAT, GEL_N_PER_MM, NOISE_MM, NOISE_N, pad_axes, true_force
from recorded_pad import recorded_pad

from fem.estimation import denoised_force as module
from fem.estimation.denoised_force import DenoisedForce
from fem.grasp_history import PadHistory

FORCE = true_force()
USED = FORCE.any(axis=(1, 2))
TURN = pad_axes(0, 1.0)
TIME = np.arange(len(FORCE)) * 1.0


def recorded(seed: int = 0, *, more: np.ndarray | float = 0.0, gel: np.ndarray | None = None) -> PadHistory:
    """A bed of springs, unless `gel` (pad axes) says otherwise; `more` force of which it knows nothing."""
    rng = np.random.default_rng(seed)
    moved = -FORCE / GEL_N_PER_MM if gel is None else gel
    force = (FORCE + more) @ TURN.T
    read = moved @ TURN.T + NOISE_MM * rng.normal(size=FORCE.shape)
    felt = force + NOISE_N * rng.normal(size=FORCE.shape)
    return recorded_pad(FLAT, felt, touching=FORCE.any(axis=2), sd_mm=NOISE_MM, sd_N=NOISE_N, gel_mm=read)


def denoised_force(pad: PadHistory, turn: np.ndarray, used: np.ndarray) -> DenoisedForce:
    """In the frames used."""
    denoised = module.denoised_force(pad, turn, used)
    assert denoised.force_N.shape == pad.force_N.shape
    return replace(denoised, force_N=denoised.force_N[used])


def off(denoised: DenoisedForce, truth: np.ndarray) -> float:
    """Root mean square error, N."""
    return float(np.sqrt(((denoised.force_N - (truth @ TURN.T)[USED]) ** 2).mean()))


def test_springs_push_by_their_displacement_with_less_noise_than_the_recorded_forces():
    pad = recorded()
    denoised = denoised_force(pad, TURN, USED)
    assert denoised.sd_N == pytest.approx(GEL_N_PER_MM[2] * NOISE_MM, rel=0.05)
    assert off(denoised, FORCE) < 0.5 * NOISE_N
    springs = -(pad.gel_displacement_mm[USED] @ TURN) * GEL_N_PER_MM @ TURN.T
    assert np.abs(denoised.force_N - springs).max() < 0.02 * FORCE.max()


def test_noise_said_to_be_left_is_the_noise_that_is_left():
    denoised = denoised_force(recorded(1), TURN, USED)
    error = (denoised.force_N - (FORCE @ TURN.T)[USED]) @ TURN
    assert error[:, :, 2].std() == pytest.approx(denoised.sd_N, rel=0.2)


def test_a_gain_stays_a_gain():
    pad = recorded(2)
    greater = denoised_force(replace(pad, force_N=1.3 * pad.force_N), TURN, USED)
    assert greater.force_N == pytest.approx(1.3 * denoised_force(pad, TURN, USED).force_N, abs=2e-3)


def test_a_drift_of_which_the_gel_knows_nothing_survives():
    drift = (TIME * 2e-3)[:, None, None] * [0.0, 0.0, 1.0]
    denoised = denoised_force(recorded(3, more=drift), TURN, USED)
    more = ((denoised.force_N - denoised_force(recorded(3), TURN, USED).force_N) @ TURN)[:, :, 2].mean(axis=1)
    np.testing.assert_allclose(more, (TIME * 2e-3)[USED], atol=3e-3)


def test_a_gel_that_is_no_bed_of_springs_keeps_its_recorded_patterns():
    gel = -np.sign(FORCE) * np.abs(FORCE / GEL_N_PER_MM) ** 0.6
    denoised = denoised_force(recorded(4, gel=gel), TURN, USED)
    assert off(denoised, FORCE) < NOISE_N


def test_where_displacement_is_the_worse_sensor_the_forces_are_taken_as_they_are():
    pad = replace(recorded(5), displacement_sd_mm=2 * NOISE_N / GEL_N_PER_MM[2])
    denoised = denoised_force(pad, TURN, USED)
    np.testing.assert_array_equal(denoised.force_N, pad.force_N[USED])
    assert denoised.sd_N == NOISE_N


def test_a_gel_that_does_not_move_says_nothing_and_the_forces_keep_their_patterns():
    pad = recorded(6, gel=np.zeros_like(FORCE))
    assert off(denoised_force(pad, TURN, USED), FORCE) < NOISE_N


def test_forces_near_their_noise_come_out_as_strong_as_they_are():
    """Touching markers are told by their noisy force; a fit to those alone would make springs too stiff."""
    truth = FORCE * (5 * NOISE_N / np.abs(FORCE).max())
    rng = np.random.default_rng(6)
    force = truth + NOISE_N * rng.normal(size=FORCE.shape)
    pad = replace(
        recorded(),
        gel_displacement_mm=(-truth / GEL_N_PER_MM + NOISE_MM * rng.normal(size=FORCE.shape)) @ TURN.T,
        force_N=force @ TURN.T,
        episode=np.where(force[:, :, 2] > 3 * NOISE_N, 0, -1),
    )
    push_N = (denoised_force(pad, TURN, USED).force_N @ TURN)[:, :, 2].sum(axis=1)
    expected = truth[USED][:, :, 2].sum(axis=1)
    assert (push_N @ expected) / (expected @ expected) == pytest.approx(1.0, abs=0.03)

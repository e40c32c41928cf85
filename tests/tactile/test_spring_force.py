"""Springs under markers: Hooke's law by hand, and noise that force and displacement share."""

import numpy as np
import pytest

from tactile.gel.slab import SpringBed
from tactile.gel.spring_force import SpringForce

SD_MM = np.array([0.001, 0.002, 0.004])


@pytest.fixture
def springs() -> SpringForce:
    information = np.broadcast_to(np.diag(SD_MM**-2.0), (9, 3, 3))
    layer = SpringBed(kn_MPa_per_mm=0.2, kt_MPa_per_mm=0.05)
    return SpringForce(layer=layer, cell_mm2=2.0, information_per_mm2=information)


def test_force_is_stiffness_times_area_times_displacement_against_it(springs):
    moved = np.tile([0.1, -0.2, -0.5], (9, 1))
    np.testing.assert_allclose(springs.force_N(moved), np.tile([-0.01, 0.02, 0.2], (9, 1)), rtol=1e-12)


def test_a_marker_that_is_not_seen_has_no_force_and_does_not_touch(springs):
    moved = np.full((9, 3), -0.1)
    moved[4] = np.nan
    assert (springs.force_N(moved)[4] == 0).all()
    assert springs.touching(moved).tolist() == [True] * 4 + [False] + [True] * 4


def test_noise_alone_seldom_touches(springs):
    noise = np.random.default_rng(3).normal(size=(2000, 9, 3)) * SD_MM
    assert springs.touching(noise).mean() < 1e-3
    assert not springs.touching(np.zeros((9, 3))).any()


def test_force_and_displacement_share_their_noise(springs):
    noise = np.random.default_rng(4).normal(size=(40_000, 9, 3)) * SD_MM
    both = np.concatenate([noise.reshape(-1, 27), springs.force_N(noise).reshape(-1, 27)], axis=1)
    covariance = springs.joint_covariance()
    spread = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(np.cov(both.T) / spread, covariance / spread, atol=0.03)
    assert covariance[2, 27 + 2] < 0

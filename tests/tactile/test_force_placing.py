"""Forces that neighbours may have exchanged: variances by hand, nothing added to the sum."""

import numpy as np

from tactile.gel.force_placing import PLACING, ForcePlacing

X, Y = (g.ravel() for g in np.meshgrid(np.arange(4.0), np.arange(3.0)))
REST = np.stack([X, Y, 0 * X], axis=1)


def test_the_steeper_the_front_the_less_is_known_of_either_side() -> None:
    row = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    force = np.zeros((4, 3))
    force[:, 2] = [0.0, 0.0, 5.0, 5.0]
    found = ForcePlacing(row).sd_N(force) / PLACING
    assert not found[:, :2].any()
    # markers 1 and 2 each exchange 5 N with the other, so that either gets it twice
    np.testing.assert_allclose(found[:, 2], [0.0, np.sqrt(50.0), np.sqrt(50.0), 0.0])


def test_the_covariance_has_these_variances_and_leaves_the_total_force_alone() -> None:
    force = np.random.default_rng(0).normal(size=(12, 3))
    placing = ForcePlacing(REST)
    covariance = placing.covariance_N2(force)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), placing.sd_N(force).ravel())
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    total = np.tile(np.eye(3), (1, 12))
    np.testing.assert_allclose(total @ covariance @ total.T, 0.0, atol=1e-12)


def test_an_even_pressure_is_known_as_well_as_before() -> None:
    assert not ForcePlacing(REST).sd_N(np.ones((12, 3))).any()

"""The stick ratio is the share that moves with the body, whatever that motion is."""

import numpy as np
import pytest

from tactile.contact_course import stick_ratio

NOISE = 0.005
X, Y = np.meshgrid(np.arange(10.0) - 4.5, np.arange(10.0) - 4.5)
PATCH = np.stack([X.ravel(), Y.ravel(), 0.02 * (X**2 + Y**2).ravel()], axis=1)
OUTSIDE = np.hypot(X, Y).ravel() > 4.6


def moved(slips: np.ndarray, *, lags: float, dims: int, frames: int = 20) -> np.ndarray:
    """The patch turns by 0.6 degrees and shifts a frame; slipping markers make 1 - `lags` of it."""
    where = [PATCH]
    for _ in range(frames - 1):
        a = 0.01
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        step = where[-1] @ turn.T + [0.12, 0.05, 0.0] - where[-1]
        where.append(where[-1] + step * np.where(slips, 1 - lags, 1.0)[:, None])
    noise = np.random.default_rng(5).normal(scale=NOISE, size=(frames, 100, 3))
    return (np.stack(where) + noise)[..., :dims]


@pytest.mark.parametrize("dims", [2, 3])
def test_a_body_that_turns_and_shifts_sticks_everywhere(dims: int) -> None:
    touching = np.ones((20, 100), dtype=bool)
    found = stick_ratio(moved(np.zeros(100, bool), lags=0, dims=dims), touching, noise=NOISE, lag=3)
    assert found.ratio.min() > 0.98


@pytest.mark.parametrize("dims", [2, 3])
def test_the_rim_that_stays_behind_is_what_slips(dims: int) -> None:
    touching = np.ones((20, 100), dtype=bool)
    found = stick_ratio(moved(OUTSIDE, lags=0.8, dims=dims), touching, noise=NOISE, lag=3)
    np.testing.assert_allclose(found.ratio[3:], 1 - OUTSIDE.mean(), atol=0.04)
    assert (found.sticks[10] == ~OUTSIDE).mean() > 0.96


def test_a_body_at_rest_sticks_and_no_contact_has_no_stick() -> None:
    still = PATCH + np.random.default_rng(2).normal(scale=NOISE, size=(12, 100, 3))
    touching = np.ones((12, 100), dtype=bool)
    touching[8:] = False
    found = stick_ratio(still, touching, noise=NOISE, lag=3)
    assert found.ratio[:8].min() > 0.97
    np.testing.assert_array_equal(found.ratio[8:], 0.0)


def test_lost_markers_do_not_slip() -> None:
    where = moved(np.zeros(100, bool), lags=0, dims=2)
    where[6:9, 40:50] = np.nan
    found = stick_ratio(where, np.ones((20, 100), dtype=bool), noise=NOISE, lag=3)
    assert found.ratio.min() > 0.98

"""A traction field spread between markers loses neither force nor moment."""

import numpy as np
import pytest

from fem.solid.traction import marker_weights, moment_correction


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

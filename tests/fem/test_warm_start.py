"""Responses computed at anchors: near one they are exact to second order, far from all a new one is made."""

import numpy as np
import pytest

from fem.mismatch.model.warm_start import MOST, NEAR, WarmStarts, quadratic_surrogate


def curved(calls: list[np.ndarray], bend: float = 0.7):
    def first_order(theta):
        return [[np.array([2.0 * theta[0] - theta[1]])]]

    def exact(theta):
        calls.append(theta)
        return [[np.array([2.0 * theta[0] - theta[1] + bend * theta[0] ** 2])]]

    return first_order, exact


def asked(search, theta, calls, **options) -> float:
    first_order, exact = curved(calls, **options)
    return float(
        quadratic_surrogate(search, "pit", np.array(theta), first_order=first_order, exact=exact)[0][0][0]
    )


def test_along_the_anchor_a_square_law_is_exact_without_another_solve():
    search, calls = WarmStarts(), []
    assert asked(search, [1.0, 0.0], calls) == pytest.approx(2.7)
    assert asked(search, [1.3, 0.0], calls) == pytest.approx(2.6 + 0.7 * 1.69)
    assert len(calls) == 1


def test_parameters_next_to_none_leave_no_anchor_behind():
    search, calls = WarmStarts(), []
    assert asked(search, [0.5 * NEAR, 0.0], calls) == pytest.approx(NEAR)
    assert not calls
    assert asked(search, [2.0, 0.0], calls) == pytest.approx(4.0 + 2.8)
    assert len(calls) == 1


def test_far_from_every_anchor_the_model_is_computed_anew():
    search, calls = WarmStarts(), []
    asked(search, [0.4, 0.0], calls)
    assert asked(search, [2.0, 0.5], calls) == pytest.approx(3.5 + 2.8)
    assert len(calls) == 2
    assert asked(search, [0.4, 0.0], calls) == pytest.approx(0.8 + 0.7 * 0.16)
    assert len(calls) == 2


def test_a_search_starts_from_the_nearest_of_its_last_solutions():
    search = WarmStarts()
    assert search.nearest("law", np.zeros(1)) is None
    for k in range(MOST + 2):
        search.keep("law", np.array([float(k)]), k)
    assert search.nearest("law", np.array([4.2])) == (np.array([4.0]), 4)
    assert search.nearest("law", np.zeros(1)) == (np.array([2.0]), 2)
    assert search.nearest("other", np.zeros(1)) is None

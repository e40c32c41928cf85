"""Anderson's acceleration against closed forms: GMRES where f is linear, the secant method in one unknown."""

import numpy as np
import pytest

from fem.solid.anderson import Anderson


def iterates(f, x, count, acceleration):
    """x and what `count` accelerated steps make of it."""
    states = [x]
    for _ in range(count):
        step = acceleration.step(f(x))
        acceleration.took(step)
        x = x + step
        states.append(x)
    return states


def linear(n, seed=0):
    """f(x) = b - A x with its zero, to which every eigenvector adds; plain steps diverge."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    A = turn @ np.diag(np.geomspace(0.3, 4.0, n)) @ turn.T
    b = turn @ np.ones(n)
    return A, b, np.linalg.solve(A, b)


def test_in_a_linear_problem_every_step_is_that_of_gmres_with_a_plain_one_after_it():
    """Walker and Ni 2011, theorem 2.2: from 0 on, GMRES has the least residual over b, A b, A A b ..."""
    n = 6
    A, b, _ = linear(n)
    states = iterates(lambda x: b - A @ x, np.zeros(n), n, Anderson(n))
    krylov = b[:, None]
    for k in range(1, n):
        gmres = krylov @ np.linalg.lstsq(A @ krylov, b, rcond=None)[0]
        np.testing.assert_allclose(states[k + 1], gmres + (b - A @ gmres), atol=1e-4)
        krylov = np.column_stack([krylov, A @ krylov[:, -1]])


def test_with_one_unknown_it_is_the_secant_method():
    def f(x):
        return np.cos(x) - x

    states = np.concatenate(iterates(f, np.array([0.3]), 6, Anderson(1)))
    for a, b, c in zip(states[:4], states[1:5], states[2:6], strict=True):
        assert c == pytest.approx(b - f(b) * (b - a) / (f(b) - f(a)), rel=1e-6)
    assert states[6] == pytest.approx(0.7390851332151607, abs=1e-9)  # Dottie's number


def test_groups_have_a_mix_each_and_one_group_has_one_for_all():
    """Two unknowns that know nothing of each other: on its own each is met by the secant in two steps."""
    slope = np.array([[0.5], [1.7]])
    apart = iterates(lambda x: 1 - slope * x, np.zeros((2, 1)), 2, Anderson(1, weighed=lambda step: step))
    together = iterates(lambda x: 1 - slope * x, np.zeros((2, 1)), 2, Anderson(1))
    assert np.abs(apart[2] - 1 / slope).max() < 1e-6
    assert np.abs(together[2] - 1 / slope).max() > 0.05


def test_only_what_is_weighed_decides_the_mix():
    """The mix is that of the first unknown alone; the second moves by it, and is no nearer its own zero."""
    slope = np.array([0.5, 1.7])
    first = Anderson(1, weighed=lambda step: step[None, :1])
    states = iterates(lambda x: 1 - slope * x, np.zeros(2), 2, first)
    assert states[2][0] == pytest.approx(2.0, abs=1e-6)
    assert abs(states[2][1] - 1 / 1.7) > 0.05

"""The search for equilibrium, by each kind of tangent, on problems whose answers are known without it."""

from dataclasses import dataclass

import numpy as np
import pytest

from fem.fem_failure import FemFailure, FemProblem
from fem.solid.equilibrium import Ending, equilibrium


@dataclass
class Dense:
    """A dense matrix as a tangent."""

    matrix: np.ndarray

    def solve(self, residual):
        return np.linalg.solve(self.matrix, residual)


@dataclass
class Spring:
    """Forces `force(x)` that must vanish, NaN beyond |x| = limit; counts its residuals."""

    force: object
    slope: object
    n: int
    limit: float = np.inf
    calls: int = 0

    @property
    def primal(self):
        return self.n

    def residual(self, x):
        self.calls += 1
        return np.where(np.abs(x) < self.limit, self.force(x), np.nan)

    def size(self, residual):
        return float(np.linalg.norm(residual))

    def moved(self, x, step, share):
        return x + share * step

    def tangent(self, x):
        matrix = self.slope(x)
        if np.linalg.eigvalsh(matrix).min() <= 0:
            raise FemFailure(FemProblem.SINGULAR_STIFFNESS, "not positive definite")
        return Dense(matrix)


def arctan():
    return Spring(np.arctan, lambda x: np.diag(1 / (1 + x**2)), 1)


def stiffening(n=30):
    """A chain of springs, each stiffer the longer it is, pulled unevenly."""
    rng = np.random.default_rng(0)
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    pull = rng.uniform(0.1, 0.3, n)
    return Spring(lambda x: chain @ x + 0.05 * x**3 - pull, lambda x: chain + np.diag(0.15 * x**2), n)


def search(problem, *, start=None, tolerance=1e-12, iterations=20, tangent=None):
    """From zero on, unless from elsewhere."""
    at = np.zeros(problem.primal) if start is None else np.array([start])
    return equilibrium(problem, at, tolerance=tolerance, iterations=iterations, tangent=tangent)


def test_a_line_search_saves_a_start_from_which_plain_newton_flies_away():
    problem, x = arctan(), 3.0
    for _ in range(4):  # plain Newton, as the textbook has it
        x -= np.arctan(x) * (1 + x**2)
    assert abs(x) > 1e6
    solved = search(problem, start=3.0, iterations=30)
    assert solved.ending is Ending.CONVERGED
    assert abs(solved.state[0]) < 1e-12


def test_states_that_no_matter_can_take_are_stepped_back_from():
    problem = Spring(np.arctan, lambda x: np.diag(1 / (1 + x**2)), 1, limit=3.5)
    assert search(problem, start=3.0, iterations=40).ending is Ending.CONVERGED


def test_chord_steps_find_the_same_with_one_factor_and_few_steps():
    problem = stiffening()
    newton = np.zeros(30)
    for _ in range(60):
        newton = newton - problem.tangent(newton).solve(problem.residual(newton))
    first = problem.tangent(np.ones(30))
    before = problem.calls
    chord = search(problem, iterations=60, tangent=first)
    taken = problem.calls - before
    assert chord.ending is Ending.CONVERGED
    assert chord.tangent is first
    assert np.abs(chord.state - newton).max() < 1e-10
    x, plain = np.zeros(30), 0
    while problem.size(problem.residual(x)) > 1e-12 and plain < 200:
        x, plain = x - first.solve(problem.residual(x)), plain + 1
    assert taken < plain


def test_a_factor_that_serves_no_more_is_renewed():
    problem = Spring(lambda x: x + x**3 - 40.0, lambda x: np.diag(1 + 3 * x**2), 1)
    poor = Dense(np.array([[200.0]]))
    solved = search(problem, tolerance=1e-13, iterations=60, tangent=poor)
    assert solved.ending is Ending.CONVERGED
    assert solved.state[0] + solved.state[0] ** 3 == pytest.approx(40.0, rel=1e-12)


def test_what_did_not_converge_says_how():
    too_few = search(stiffening(), iterations=2)
    assert too_few.ending is Ending.TOO_MANY
    hill = Spring(lambda x: -x + 1.0, lambda x: -np.eye(1), 1)
    assert search(hill, iterations=9).ending is Ending.STALLED


def test_nothing_is_done_where_all_is_in_balance():
    problem = arctan()
    assert search(problem, iterations=5).ending is Ending.CONVERGED
    assert problem.calls == 1

"""Cramer-Rao bounds on small problems whose amounts are known."""

import numpy as np
import pytest
from cramer_rao import amplitude_bounds
from synthetic_problem import problem


def information(case):
    """Of products whose numbers have a variance of one."""
    return sum(products[1:, 1:] for products in case.products)


def test_the_bound_is_that_of_independent_columns():
    """Information of a column of n numbers of variance one: n."""
    case = problem({}, numbers=2000)
    assert amplitude_bounds(information(case), case, E_MPa=0.5)["graded_modulus"] == pytest.approx(
        1 / np.sqrt(4 * 2000), rel=0.03
    )


def test_the_bound_is_the_scatter_of_unbiased_estimates():
    fits = [
        problem({"clock_lag": 0.2}, seed=seed, numbers=60).gram().fit([1, 2, 3, 4, 5]) for seed in range(150)
    ]
    scatter = np.std([fit.amounts[4] for fit in fits])
    case = problem({}, numbers=60)
    assert scatter == pytest.approx(
        amplitude_bounds(information(case), case, E_MPa=0.5)["clock_lag"], rel=0.15
    )

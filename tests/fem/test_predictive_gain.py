"""How much better a model predicts recordings left out: against dense Gaussian densities."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fem.mismatch.evidence.linear_evidence import PLAIN_SD, GramMatrix
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.selection.cross_validation import predictive, predictive_gain

NUMBERS, SD = 30, 0.8


def dense(data: list[np.ndarray], fields: list[list[np.ndarray]], sd: list[float]) -> float:
    """ln p of recordings that share the amounts of their fields."""
    stacked = np.concatenate(data)
    columns = [np.concatenate(parts) for parts in zip(*fields, strict=True)]
    covariance = np.eye(len(stacked)) + sum(s**2 * np.outer(c, c) for s, c in zip(sd, columns, strict=True))
    return float(multivariate_normal.logpdf(stacked, cov=covariance))


def test_it_is_the_density_of_each_recording_given_the_others():
    rng = np.random.default_rng(8)
    fields = [[rng.normal(size=NUMBERS) for _ in range(2)] for _ in range(3)]
    data = [0.6 * grasp_fields[1] + rng.normal(size=NUMBERS) for grasp_fields in fields]
    rows = [np.vstack([values, *grasp_fields]) for values, grasp_fields in zip(data, fields, strict=True)]
    products = GramMatrix.from_products(
        [Regressor(name="1/E", sd=PLAIN_SD, fields=()), Regressor(name="effect", sd=SD, fields=())],
        [np.arange(2)] * 3,
        [grasp_rows @ grasp_rows.T for grasp_rows in rows],
    )
    before, after = predictive(products, ()), predictive(products, (1,))

    def expected(k: int, count: int) -> float:
        others = [j for j in range(3) if j != k]
        sd = [PLAIN_SD, SD][:count]
        used = [grasp_fields[:count] for grasp_fields in fields]
        rest = dense([data[j] for j in others], [used[j] for j in others], sd)
        return dense(data, used, sd) - rest

    each = [expected(k, 2) - expected(k, 1) for k in range(3)]
    np.testing.assert_allclose(after - before, each, atol=1e-8)
    gain, error = predictive_gain(before, after)
    assert gain == pytest.approx(sum(each))
    assert error == pytest.approx(np.sqrt(3) * np.std(each, ddof=1))


def test_a_single_recording_has_none():
    assert predictive_gain(None, np.ones(2)) is None

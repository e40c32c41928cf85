"""Baselines and bounds on small problems whose amounts are known."""

import numpy as np
import pytest
from sealed_truths import put_on_path
from synthetic_problem import EFFECTS, problem

pytest.importorskip("sklearn")
put_on_path()
from baseline_answers import baselines_of  # noqa: E402
from cramer_rao import amplitude_bounds  # noqa: E402
from gaussian_process import gaussian_process  # noqa: E402
from random_forest import Forest  # noqa: E402
from sparse_regression import chosen_terms, eliminated, sparse_regression  # noqa: E402
from weighed_residual import squares_of, weighed_squares  # noqa: E402

from fem.mismatch.result import Modulus  # noqa: E402

E = Modulus(value=0.5, sd=0.005)


def test_sparse_regression_finds_the_terms_that_are_there_and_their_modulus():
    found = sparse_regression(problem({"skin": 0.4, "clock_lag": -0.8}, share=0.1), E)
    assert found["order"] == ["clock_lag", "skin"]
    assert found["E"][0] == pytest.approx(0.5 / 1.1, rel=0.06)
    assert found["heldout_ratio"] < 0.7


def test_sparse_regression_names_nothing_on_noise():
    found = [sparse_regression(problem({}, seed=seed), E)["verdict"] for seed in range(8)]
    assert found.count(["none"]) >= 7


def test_eliminated_products_are_those_of_the_residual_of_a_regression_on_the_rest():
    """Frisch, Waugh and Lovell: amounts of terms beside nuisances are those of residuals on residuals."""
    case = problem({"skin": 0.4})
    normal, right = eliminated(case, [0, 1], [2, 3, 4, 5])
    whole = case.gram().fit([1, 2, 3, 4, 5])
    prior = np.eye(4) / 9
    assert np.linalg.solve(normal + prior, right) == pytest.approx(whole.amounts[2:], abs=1e-9)


def test_terms_that_are_twins_do_not_stop_the_search():
    normal = np.array([[100.0, 100.0, 0.0], [100.0, 100.0, 0.0], [0.0, 0.0, 100.0]])
    assert 2 not in chosen_terms(normal, np.array([50.0, 50.0, 1.0]))


def test_held_out_squares_are_those_of_the_residual_itself():
    case = problem({"skin": 0.4}, recordings=2)
    rng = np.random.default_rng(1)
    fields, data = rng.normal(size=(6, 50)), rng.normal(size=50)
    both = np.vstack([data, fields])
    case.products[0] = both @ both.T
    amounts = {0: 0.3, 2: -0.2}
    residual = data - 0.3 * fields[0] + 0.2 * fields[2]
    assert squares_of(case.gram(), 0, amounts) == pytest.approx(float(residual @ residual))


def test_a_true_column_lowers_the_held_out_squares_and_a_false_one_does_not():
    case = problem({"skin": 0.4})
    gram = case.gram()
    plain = weighed_squares(gram, [1])
    assert weighed_squares(gram, [1, 2]) < 0.95 * plain
    assert weighed_squares(gram, [1, 3]) > 0.999 * plain


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
    found = [
        problem({"clock_lag": 0.2}, seed=seed, numbers=60).gram().fit([1, 2, 3, 4, 5]) for seed in range(150)
    ]
    scatter = np.std([fit.amounts[4] for fit in found])
    case = problem({}, numbers=60)
    assert scatter == pytest.approx(
        amplitude_bounds(information(case), case, E_MPa=0.5)["clock_lag"], rel=0.15
    )


def smooth_samples(size, *, share=0.0):
    rng = np.random.default_rng(2)
    n = 240
    x, y = rng.uniform(-6, 6, (2, n))
    load, time_s = rng.uniform(0, 1, n), rng.uniform(0, 5, n)
    response = 0.1 * load
    residual = size * np.cos(x / 3) * load + share * response + rng.normal(0, 0.004, n)
    return np.column_stack(
        [np.arange(n) % 4, np.zeros(n), x, y, load, time_s, residual, response, np.full(n, 0.004)]
    )


def test_a_gaussian_process_says_unknown_of_a_smooth_residual_and_predicts_what_is_held_out():
    found = gaussian_process(smooth_samples(0.02), E)
    assert found["verdict"] == ["unknown"]
    assert found["heldout_ratio"] < 0.3
    assert found["order"] == []


def test_a_gaussian_process_leaves_noise_alone():
    found = gaussian_process(smooth_samples(0.0), E)
    assert found["verdict"] == ["none"]
    assert found["E"][0] == pytest.approx(0.5, rel=0.05)


def features(effect, rng):
    gains = {name: float(rng.normal(0.0, 1.0) + (30.0 if name == effect else 0.0)) for name in EFFECTS}
    return {"gains": gains, "statistics": {"best single": max(gains.values())}, "variance": {}}


def test_a_forest_names_what_gains_most_on_cases_it_has_not_seen():
    rng = np.random.default_rng(4)
    truths = [*EFFECTS, "none"] * 8
    rows = [{"truth": t, "fruit": f"f{k}", "features": features(t, rng)} for k, t in enumerate(truths)]
    forest = Forest(rows)
    assert forest.accuracy() > 0.9
    assert forest.answer(features("clock_lag", rng))["order"][0] == "clock_lag"
    assert forest.answer(features("none", rng))["verdict"] == ["none"]


def test_all_baselines_answer_in_plain_json_values():
    import json

    found = baselines_of(problem({"skin": 0.4}), E=E)
    assert list(json.loads(json.dumps(found))) == ["modulus alone", "Gaussian process", "sparse regression"]

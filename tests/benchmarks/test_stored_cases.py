"""Stored linear problems replay through the selection code to the gains they had, and to the truth.

Cases are the first labelled cases of an external contact simulation. `git show
4ce97fb9:benchmarks/sealed/bank_features.py` wrote them.
"""

from pathlib import Path

import numpy as np
import pytest
from sealed_truths import put_on_path
from synthetic_problem import EFFECTS, problem

put_on_path()
from reduced_case import OF_MODEL_ERROR, gains_of, store, stored  # noqa: E402

from fem.mismatch.evidence.model_error import model_error_shares  # noqa: E402
from fem.mismatch.result import NONE, UNKNOWN  # noqa: E402
from fem.mismatch.selection.decision import Weighed, credible_set, probabilities  # noqa: E402
from fem.mismatch.selection.screening import log_positive, violates_sign_constraint  # noqa: E402

CASES = sorted((Path(__file__).parent / "cases").glob("*.npz"))
LARGEST_BYTES = 300_000


def test_there_are_cases():
    assert len(CASES) >= 12


def gains_of_symmetric_priors(linear):
    """Gains as these files have them, greatest first: an amount of the wrong sign gains nothing, and no other
    evidence is of its sign.
    """
    gains = {}
    for fit in linear.linear_fits:
        among_nuisances = linear.products.fit([*linear.nuisances, *fit.columns])
        gain = fit.gain - log_positive(linear.products, fit.columns, among_nuisances)
        if violates_sign_constraint(linear.products, fit.columns, fit.amounts):
            gain = min(gain, 0.0)
        gains[fit.name] = max(gain, gains.get(fit.name, -np.inf))
    return dict(sorted(gains.items(), key=lambda pair: -pair[1]))


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_a_case_replays_to_the_gains_it_had(path):
    case = stored(path)
    found = gains_of_symmetric_priors(case.linear())
    assert found.keys() == case.facts["gains"].keys()
    assert list(found) == list(case.facts["gains"])
    assert np.array(list(found.values())) == pytest.approx(
        np.array(list(case.facts["gains"].values())), abs=1e-3, rel=1e-4
    )


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_the_linear_round_names_the_truth_but_for_known_misses(path):
    """With the model error of its time, and with that of today's file. Skin and pit offset come second in the
    linear round, and first once every law is fitted in full.
    """
    case = stored(path)
    truth = case.facts["truth"]
    for replayed in (case, case.with_shipped_model_error()):
        linear = replayed.linear()
        verdict = replayed.linear_verdict(linear)
        if truth in ("skin", "pit_offset"):
            assert verdict != NONE
            assert linear.best[1].name == truth
        else:
            assert verdict == truth


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_the_credible_set_of_the_linear_round_holds_the_truth(path):
    case = stored(path).with_shipped_model_error()
    linear = case.linear()
    weighed = [
        Weighed(
            name=fit.name,
            gain=fit.gain,
            misfit=(linear.null.chi2 - fit.chi2_drop) / case.count,
            direct=fit.direct,
        )
        for fit in linear.best
    ]
    weighed.append(Weighed(name=NONE, gain=0.0, misfit=linear.null.chi2 / case.count))
    shares, unknown = probabilities(weighed)
    names = [*(explanation.name for explanation in weighed), UNKNOWN]
    assert case.facts["truth"] in credible_set(names, [*shares, unknown])


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_a_case_is_small(path):
    assert path.stat().st_size < LARGEST_BYTES


def test_a_problem_is_read_as_it_was_written(tmp_path):
    case = problem({"skin": 0.4})
    store(tmp_path / "x.npz", case)
    again = stored(tmp_path / "x.npz")
    assert again.columns == case.columns
    assert again.signatures == case.signatures
    for was, now in zip(case.products, again.products, strict=True):
        assert np.array_equal(was, now)
    assert gains_of(again.linear()) == gains_of(case.linear())


def test_model_error_enters_as_copies_of_signature_columns_with_the_shipped_spread(tmp_path):
    """A case of two effects' columns by hand: with a prior of sd s on a copy, the signature's information N
    becomes N / (1 + N s^2) (Woodbury)."""
    case = problem({"skin": 0.4}, recordings=1)
    again = case.with_shipped_model_error()
    store(tmp_path / "x.npz", again)
    assert stored(tmp_path / "x.npz").columns == again.columns
    errors = [column for column in again.columns if column["role"] in OF_MODEL_ERROR]
    assert {again.columns[column["same_as"]]["name"] for column in errors} == {
        name for name in EFFECTS if name in model_error_shares()
    }
    (copy,) = (column for column in errors if again.columns[column["same_as"]]["name"] == "skin")
    assert copy["sd"] == pytest.approx(3.0 * model_error_shares()["skin"])
    others = [1, *(j for j, column in enumerate(again.columns) if column in errors and column is not copy)]
    skin, copied = again.columns[copy["same_as"]], again.columns.index(copy)
    information, _ = again.gram().marginal(others, [again.columns.index(skin)])
    widened, _ = again.gram().marginal([*others, copied], [again.columns.index(skin)])
    assert widened[0, 0] == pytest.approx(information[0, 0] / (1 + information[0, 0] * copy["sd"] ** 2))


def test_todays_model_error_takes_the_place_of_another():
    case = problem({"skin": 0.4}).with_shipped_model_error()
    again = case.with_shipped_model_error()
    assert again.columns == case.columns
    assert all(np.array_equal(*pair) for pair in zip(again.products, case.products, strict=True))


def test_the_linear_round_of_a_synthetic_problem_names_what_is_in_it():
    linear = problem({"clock_lag": 0.5}).linear()
    assert linear.best[0].effect.spec.name == "clock_lag"
    assert linear.best[0].amounts[0] == pytest.approx(0.5, abs=0.1)


def test_an_amount_of_the_wrong_sign_gains_nothing():
    gains = gains_of(problem({"gripper_compliance": -0.5}).linear())
    assert gains["gripper_compliance"] <= 0

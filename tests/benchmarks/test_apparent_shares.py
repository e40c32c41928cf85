"""The model error's shares and bounds of amounts, against known amounts and closed forms."""

import csv
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from apparent_shares import (
    SCALES,
    USUAL_SHARES,
    ModelError,
    NullCase,
    file_text,
    likeliest_scale_prior,
    model_error_of,
    null_cases,
    usual_share_of,
)
from cramer_rao import amplitude_bounds
from mismatch_scores import usual_misfit
from scipy.stats import multivariate_normal
from synthetic_problem import problem

from fem.mismatch.evidence import model_error
from fem.mismatch.evidence.model_error import SIZE, ScalePrior
from fem.mismatch.selection.decision import FREEDOM, MISFIT

ROWS = Path(__file__).parents[2] / "benchmarks" / "results" / "null-fruit.csv"


def null(fruit, normal, right, *, unit_sd, effect, effects=("skin",), surface_sd=0.0):
    return NullCase(
        fruit=fruit,
        normal=np.asarray(normal, dtype=float),
        right=np.asarray(right, dtype=float),
        unit_sd=np.asarray(unit_sd, dtype=float),
        surface_sd=np.full(len(right), surface_sd),
        effect=np.asarray(effect),
        effects=effects,
    )


def drawn(share, *, count, information, unit_sd=0.8, surface_sd=0.0, seed=3):
    """Cases of one column, whose data are an amount and noise."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        amount = np.hypot(share * unit_sd, surface_sd) * rng.normal()
        right = information * amount + np.sqrt(information) * rng.normal()
        yield null(
            f"null-{number}", [[information]], [right], unit_sd=[unit_sd], effect=[0], surface_sd=surface_sd
        )


def test_a_known_share_is_measured_noise_removed():
    """Noise is as large as the amounts: left in, the share would be 41 % too large."""
    cases = list(drawn(0.05, count=2000, information=(0.05 * 0.8) ** -2))
    assert model_error_of(cases)["skin"] == pytest.approx(0.05, rel=0.06)


def test_the_error_of_the_surface_is_no_part_of_the_share():
    """It is as large as the share's: counted twice, the share would be 41 % too large."""
    cases = list(drawn(0.05, count=2000, information=(0.02 * 0.8) ** -2, surface_sd=0.05 * 0.8))
    assert model_error_of(cases)["skin"] == pytest.approx(0.05, rel=0.08)


def test_noise_alone_leaves_hardly_any_share():
    """The noise of one amount is a share of 0.01."""
    assert model_error_of(list(drawn(0.0, count=500, information=(0.01 * 0.8) ** -2)))["skin"] < 0.005


def test_the_usual_share_follows_from_held_out_fruit():
    """Of four effects of each fruit: none has an error, or all have one of 0.02."""
    rng, count = np.random.default_rng(4), 4
    names = tuple(f"effect {k}" for k in range(count))
    usual = []
    for share in (0.0, 0.02):
        cases = []
        for number in range(6):
            normal = np.diag(np.full(count, 0.005**-2))
            right = normal @ (share * rng.normal(size=count)) + 0.005**-1 * rng.normal(size=count)
            fruit = f"f-{number}"
            cases.append(
                null(fruit, normal, right, unit_sd=np.ones(count), effect=range(count), effects=names)
            )
        usual.append(usual_share_of(cases))
    assert usual == [min(USUAL_SHARES), max(USUAL_SHARES)]


def test_an_error_is_not_counted_again_by_an_effect_that_resembles_it():
    """Two columns with a correlation of 0.9; only the first has an amount."""
    rng = np.random.default_rng(5)
    normal = 1e8 * np.array([[1.0, 0.9], [0.9, 1.0]])
    root = np.linalg.cholesky(normal)
    cases = []
    for number in range(60):
        right = normal @ [0.1 * rng.normal(), 0.0] + root @ rng.normal(size=2)
        cases.append(
            null(f"f-{number}", normal, right, unit_sd=[1.0, 1.0], effect=[1, 0], effects=("skin", "slip"))
        )
    shares = model_error_of(cases)
    assert shares["slip"] == pytest.approx(0.1, rel=0.2)
    assert shares["skin"] < 0.005


def test_each_fruit_counts_once_however_many_cases_it_has():
    single, other = drawn(0.05, count=2, information=1e8)
    assert model_error_of([single, *[other] * 5]) == pytest.approx(model_error_of([single, other]), rel=1e-3)


def test_the_gradient_is_that_of_the_density():
    rng = np.random.default_rng(8)
    fields, data = rng.normal(size=(5, 30)), rng.normal(size=30)
    case = null(
        "f", fields @ fields.T, fields @ data, unit_sd=[1, 2, 0.5, 1, 3], effect=[0, 1, 1, 0, 2],
        effects=("skin", "slip", "damage"),
    )  # fmt: skip
    logs = np.log([0.3, 0.1, 0.2])

    def density(logs):
        return case.log_density(dict(zip(case.effects, np.exp(logs), strict=True)))

    numeric = [(density(logs + h) - density(logs - h)) / 2e-5 for h in 1e-5 * np.eye(3)]
    shares = dict(zip(case.effects, np.exp(logs), strict=True))
    assert case.gradient(shares) == pytest.approx(numeric, rel=1e-6)


def test_the_density_is_that_of_dense_data():
    """b of 40 numbers with unit noise, and amounts of the columns with standard deviation k sd."""
    rng = np.random.default_rng(6)
    fields, data, sd = rng.normal(size=(3, 40)), rng.normal(size=40), np.array([0.3, 0.0, 0.8])
    case = null("f", fields @ fields.T, fields @ data, unit_sd=sd, effect=[0, 0, 0])
    dense = [
        multivariate_normal(cov=np.eye(40) + (k * sd) ** 2 * fields.T @ fields).logpdf(data)
        for k in (0.5, 2.0)
    ]
    shares = {"skin": 1.0}
    assert case.log_density(shares, 2.0) - case.log_density(shares, 0.5) == pytest.approx(dense[1] - dense[0])


def test_a_stored_round_gives_the_equations_without_model_error():
    case = problem({"skin": 0.4})
    case.facts["answer"] = {}
    bare, full = (null_cases({"null-1-1": each})[0] for each in (case, case.with_shipped_model_error()))
    assert full.normal == pytest.approx(bare.normal)
    assert full.right == pytest.approx(bare.right)
    assert full.unit_sd == pytest.approx(bare.unit_sd)


def test_the_file_holds_shares_by_name_and_names_their_origin():
    cases = [*drawn(0.05, count=3, information=1e8), *drawn(0.05, count=1, information=1e8)]
    text = file_text(
        cases,
        ModelError(shares={"skin": 0.03, "slip": 1e-4}, prior=ScalePrior(size=0.66, freedom=3.0)),
        command="python benchmarks/mismatch_scores.py",
        written=date(2026, 11, 28),
    )
    lines = text.splitlines()
    header = " ".join(line for line in lines if line.startswith("#"))
    assert "4 cases of 3 fruit" in header
    assert "python benchmarks/mismatch_scores.py, 2026-11-28" in header
    shares = {row["effect"]: row["share"] for row in csv.DictReader(x for x in lines if x[0] != "#")}
    assert shares == {SIZE: "0.66", model_error.FREEDOM: "3", "skin": "0.03", "slip": "0.0001"}


def test_the_priors_size_and_freedom_are_those_of_drawn_fruit():
    """400 fruit with one precise amount of each of six effects; the scale has four degrees of freedom."""
    rng = np.random.default_rng(7)
    truth = ScalePrior(size=0.7, freedom=4.0)
    by_fruit = []
    for k in truth.drawn(400, rng):
        amounts = k * 0.1 * rng.standard_normal(6)
        case = null("f", 1e8 * np.eye(6), 1e8 * amounts, unit_sd=np.full(6, 0.1), effect=[0] * 6)
        by_fruit.append([case.log_density({"skin": 1.0}, scale) for scale in SCALES])
    fitted = likeliest_scale_prior(np.array(by_fruit))
    assert fitted.size == pytest.approx(0.7, rel=0.1)
    assert 3 <= fitted.freedom <= 7


def test_usual_misfit_is_that_of_the_stored_cases_without_mismatch():
    lines = ROWS.read_text(encoding="utf-8").splitlines()
    rows = [row for row in csv.DictReader(lines) if row["kind"] == "sound"]
    assert len(rows) == 17
    mean, freedom = usual_misfit([(row["fruit"], float(row["misfit"])) for row in rows])
    assert mean == pytest.approx(MISFIT, rel=0.01)
    assert freedom == pytest.approx(FREEDOM, rel=0.01)


def test_usual_misfit_of_drawn_fruit_has_their_freedom():
    rng = np.random.default_rng(2)
    cases = [(f"f-{k}", 0.04 * x / 12) for k, x in enumerate(rng.chisquare(12, size=4000))]
    assert usual_misfit(cases) == pytest.approx((0.04, 12), rel=0.05)


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

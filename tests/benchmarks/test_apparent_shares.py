"""The model error's shares against known amounts and closed forms."""

import csv
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sealed_truths import put_on_path

put_on_path()
from apparent_shares import (  # noqa: E402
    SCALES,
    file_text,
    log_density,
    model_error_of,
    scale_prior,
    squared_shares,
)
from mismatch_scores import usual_misfit  # noqa: E402

from fem.mismatch.evidence import model_error  # noqa: E402
from fem.mismatch.evidence.model_error import (  # noqa: E402
    SIZE,
    NullDraws,
    ScalePrior,
)
from fem.mismatch.evidence.signature_equations import SignatureEquations  # noqa: E402
from fem.mismatch.selection.decision import FREEDOM, MISFIT  # noqa: E402

RATIO, SD = 2.5, 0.4
ROWS = Path(__file__).parents[2] / "benchmarks" / "results" / "mismatch-bank.csv"


def equations(normal, right, ways):
    count = len(right)
    return SignatureEquations(
        normal=np.asarray(normal, dtype=float),
        right=np.asarray(right, dtype=float),
        sd=np.full(count, SD),
        positive=np.zeros(count, dtype=bool),
        least=np.zeros(count),
        ways=ways,
    )


def rows_of_amounts(amounts, information):
    """Cases of one column, whose data are an amount and noise."""
    rng = np.random.default_rng(4)
    for number, amount in enumerate(amounts):
        right = information * amount + np.sqrt(information) * rng.normal()
        squares = squared_shares(
            equations([[information]], [right], {"skin": [(0,)]}), compliance_ratio=RATIO
        )
        yield {"fruit": f"null-{number}", "squared_shares": squares}


def test_a_known_share_is_measured_noise_removed():
    """Noise is a third of the amounts: left in, the share would be 5 % too large."""
    injected = 0.05
    amounts = injected * SD * RATIO * np.random.default_rng(3).normal(size=4000)
    information = (3 / (injected * SD * RATIO)) ** 2
    assert model_error_of(list(rows_of_amounts(amounts, information)))["skin"] == pytest.approx(
        injected, rel=0.03
    )


def test_each_signature_is_fitted_alone_and_the_mean_is_over_all_columns():
    """Of three columns, two of one signature and one of another that is correlated with them."""
    information = 1e8
    normal = information * np.array([[1.0, 0.0, 0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 1.0]])
    true = np.array([0.3, 0.1, 0.0])
    ways = {"pit_offset": [(0, 1), (2,)], "slip": [(1,)], "adhesion": []}
    squares = squared_shares(equations(normal, normal @ true, ways), compliance_ratio=RATIO)
    assert set(squares) == {"pit_offset", "slip"}
    alone = np.array([0.3, 0.1, 0.6 * 0.3]) / SD / RATIO
    assert squares["pit_offset"] == pytest.approx(np.mean(alone**2), rel=1e-4)
    assert squares["slip"] == pytest.approx(alone[1] ** 2, rel=1e-4)


ROWS_OF_TWO_FRUIT = [
    {"fruit": "null-200", "squared_shares": {"skin": 0.03**2, "slip": 0.0009**2}},
    {"fruit": "null-200", "squared_shares": {"skin": 0.05**2, "damage": 0.0123456**2}},
    {"fruit": "null-201", "squared_shares": {"skin": 0.01**2}},
]


def test_each_fruit_counts_once_however_many_cases_it_has():
    """(0.03^2 + 0.05^2) / 2 = 0.0017 of the first fruit, 0.0001 of the second."""
    assert model_error_of(ROWS_OF_TWO_FRUIT)["skin"] == pytest.approx(0.03)


def test_the_file_holds_shares_by_name_and_names_their_origin():
    text = file_text(
        ROWS_OF_TWO_FRUIT,
        ScalePrior(size=0.66, freedom=3.0),
        command="python benchmarks/mismatch_scores.py",
        written=date(2026, 11, 28),
    )
    lines = text.splitlines()
    header = " ".join(line for line in lines if line.startswith("#"))
    assert "3 cases of 2 fruit" in header
    assert "python benchmarks/mismatch_scores.py, 2026-11-28" in header
    shares = {row["effect"]: row["share"] for row in csv.DictReader(x for x in lines if x[0] != "#")}
    assert shares == {SIZE: "0.66", model_error.FREEDOM: "3", "damage": "0.00617", "skin": "0.03"}


def test_the_density_of_a_scale_is_that_of_dense_data():
    """b of 40 numbers with unit noise, and amounts of the columns with standard deviation k sd."""
    rng = np.random.default_rng(6)
    fields, data, sd = rng.normal(size=(3, 40)), rng.normal(size=40), np.array([0.3, 0.0, 0.8])
    bare = equations(fields @ fields.T, fields @ data, {})
    draws = NullDraws(bare=bare, error_sd=sd, prior=ScalePrior(size=1.0, freedom=3.0))
    dense = [
        multivariate_normal(cov=np.eye(40) + (k * sd) ** 2 * fields.T @ fields).logpdf(data)
        for k in (0.5, 2.0)
    ]
    assert log_density(draws, 2.0) - log_density(draws, 0.5) == pytest.approx(dense[1] - dense[0])


def test_the_priors_size_and_freedom_are_those_of_drawn_fruit():
    """400 fruit with one precise amount of each of six effects; the scale has four degrees of freedom."""
    rng = np.random.default_rng(7)
    truth = ScalePrior(size=0.7, freedom=4.0)
    by_fruit = []
    for k in truth.drawn(400, rng):
        amounts = k * 0.1 * rng.standard_normal(6)
        bare = equations(1e8 * np.eye(6), 1e8 * amounts, {})
        draws = NullDraws(bare=bare, error_sd=np.full(6, 0.1), prior=truth)
        by_fruit.append([log_density(draws, scale) for scale in SCALES])
    fitted = scale_prior(np.array(by_fruit))
    assert fitted.size == pytest.approx(0.7, rel=0.1)
    assert 3 <= fitted.freedom <= 7


def test_usual_misfit_is_that_of_the_stored_cases_without_mismatch():
    lines = ROWS.read_text(encoding="utf-8").splitlines()
    rows = [row for row in csv.DictReader(lines) if row["kind"] == "sound"]
    assert len(rows) == 38
    mean, freedom = usual_misfit([(row["fruit"], float(row["misfit"])) for row in rows])
    assert mean == pytest.approx(MISFIT, rel=0.01)
    assert freedom == pytest.approx(FREEDOM, rel=0.01)

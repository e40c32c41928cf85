"""Tables of the sealed proof on answers whose scores are known by hand."""

import numpy as np
import pytest
from psychometric import fitted_curve
from sealed_report import report
from sealed_scores import interval, parameter_rows, scored
from sealed_truths import label, row

SKIN = {"Et_N_per_mm": {"value": 1.1, "sd": 0.1, "interval": [0.94, 1.26]}}
CASES = {
    "a": (label("sound", "none"), row("a", ["none"], p=0.6)),
    "b": (label("sound", "none"), row("b", ["slip"], p=0.01, first="slip", probability=0.7)),
    "c": (
        label("single", "skin", Et_N_per_mm=1.0),
        row("c", ["skin"], p=1e-4, first="skin", probability=0.97, parameters=SKIN),
    ),
    "d": (label("single", "slip", mu=0.2), row("d", ["none"], p=0.3, signal=2.0)),
    "e": (
        label("pair", "skin+slip", skin={"Et_N_per_mm": 1.0}, slip={"mu": 0.1}),
        row("e", ["skin+slip", "skin"], p=1e-5, first="skin+slip", E=(0.6, 0.01)),
    ),
    "f": (label("outside", "unknown", physics="palm"), row("f", ["unknown"], p=1e-5, first="slip")),
    "g": (label("outside", "unknown", physics="drainage"), row("g", ["viscoelastic"], first="viscoelastic")),
}
LABELS = {name: case_label for name, (case_label, _) in CASES.items()}


def lines(**changed):
    rows = [answer | changed.get(name, {}) for name, (_, answer) in CASES.items()]
    return report(rows, LABELS)


def line(start, reported):
    return next(text for text in reported if text.strip().startswith(start))


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ("false alarms", "1 of 2"),
        ("single effects detected", "1 of 2"),
        ("named first, signal/noise over 10", "1 of 1"),
        ("named first, all", "1 of 2"),
        ("pairs with both named", "1 of 1"),
        ("verdict covers the truth", "2 of 2"),
        ("outside the catalogue: called unknown", "1 of 2"),
        ("unknown or a relative", "2 of 2"),
        ("parameters inside", "1 of 1"),
        ("E in the end, all", "6 of 7"),
        ("E in the end, pair", "0 of 1"),
        ("skin+slip ", "1 x [skin+slip | skin]"),
        ("this finder", "1 of 2"),
    ],
)
def test_each_share_is_what_it_is_by_hand(start, said):
    assert said in line(start, lines())


def test_a_case_without_an_answer_is_reported_and_not_scored():
    reported = lines(a={"failure": "ValueError: x"})
    assert line("6 answers, 1 cases without one", reported)
    assert "1 of 1" in line("false alarms", reported)


def test_a_physics_that_the_catalogue_has_learnt_counts_as_a_single_effect():
    case = scored({**CASES["f"][1], "catalogue": ["skin", "third_contact"]}, LABELS["f"])
    assert (case.kind, case.truth) == ("single", "third_contact")
    case = scored({**CASES["g"][1], "catalogue": ["skin", "drainage"]}, LABELS["g"])
    assert (case.kind, case.truth) == ("single", "drainage")


def test_a_drift_is_scored_in_newtons_of_the_simulated_peak():
    drift = {"newton_per_s": {"value": 0.11, "sd": 0.01, "interval": [0.09, 0.13]}}
    answer = row("x", ["sensor_drift"], first="sensor_drift", parameters=drift)
    ((name, error, inside),) = parameter_rows(
        scored(answer, label("single", "sensor_drift", pad="left", share_per_s=0.01))
    )
    assert name == "sensor_drift.newton_per_s"
    assert error == pytest.approx(0.1)
    assert inside


def test_binomial_intervals_are_those_of_the_tables():
    """Clopper and Pearson 1934: none of 10 within 0 to .3085, 5 of 10 within .1871 to .8129."""
    assert interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert interval(5, 10) == pytest.approx((0.1871, 0.8129), abs=1e-4)


def test_a_curve_finds_the_half_of_the_law_that_drew_its_cases():
    rng = np.random.default_rng(3)
    x = np.exp(rng.uniform(np.log(0.01), np.log(10.0), 600))
    seen = rng.uniform(size=600) < 1 / (1 + (0.3 / x) ** 2.5)
    curve = fitted_curve(x.tolist(), seen.tolist())
    assert curve.half == pytest.approx(0.3, rel=0.2)
    assert curve.steepness == pytest.approx(2.5, rel=0.25)


def test_a_curve_of_cases_all_seen_is_finite_and_marked():
    curve = fitted_curve([1.0, 2.0, 4.0], [True, True, True])
    assert np.isfinite(curve.half)
    assert not curve.bracketed
    assert curve.half < 1.0

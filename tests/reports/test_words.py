from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.entries import FruitEntry
from reports.words import number, percent, remarks, verdict, with_sd


@given(st.floats(1e-6, 1e7))
def test_a_figure_is_told_to_three_digits(value):
    assert float(number(value)) == pytest.approx(value, rel=0.0051)


@given(st.floats(0.01, 10.0), st.floats(1e-4, 1.0))
def test_value_and_deviation_share_their_decimals_and_keep_the_deviation(value, share):
    printed, deviation = with_sd(value, share * value).split(" ± ")
    assert len(printed.partition(".")[2]) == len(deviation.partition(".")[2])
    assert float(printed) == pytest.approx(value, abs=0.5 * share * value + 1e-4 * value)


@given(st.floats(0.0, 1.0))
def test_no_probability_is_told_as_certain(probability):
    assert percent(probability).replace("\u00a0", " ") not in {"0 %", "100 %"}


def test_fruit_that_wait_in_an_unfinished_run_are_counted():
    done = FruitEntry(fruit_id="a", ok=True, outcome="graded", E_MPa=0.4)
    assert verdict((done,), waiting=3).startswith("1 of 4 fruit graded: a has E")
    lost = FruitEntry(fruit_id="b", ok=False, outcome="no-fruit")
    assert verdict((lost,), waiting=3) == "0 of 4 fruit graded."


def test_a_doubt_about_E_stands_before_the_warnings():
    doubted = FruitEntry(
        fruit_id="a", ok=True, outcome="graded", E_MPa=0.4, doubts=("grasp-1: a gain.",), warnings=("dim",)
    )
    assert remarks(doubted) == "E is in doubt, 1 warning"
    assert remarks(replace(doubted, class_withheld=True)) == "E is in doubt, so no class, 1 warning"
    assert verdict((doubted,)) == "The only fruit is graded: a has E = 0.400 MPa, in doubt.".replace(
        "0.400 MPa", "0.400\u00a0MPa"
    )

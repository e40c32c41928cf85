"""Ranking and classes from moduli with error bars."""

import numpy as np
import pytest
from scipy.stats import norm

from pipeline.batch.settings import GradingClass
from pipeline.ranking.maturity import agreement, maturity, standings

CLASSES = (
    GradingClass(name="soft", E_max_MPa=0.3),
    GradingClass(name="ripe", E_max_MPa=0.7),
    GradingClass(name="firm"),
)


def stand(E, sd, common=0.0, seed=1):
    E, sd = np.array(E), np.array(sd)
    return standings(E, sd, common * np.ones_like(E), classes=CLASSES, rng=np.random.default_rng(seed))


def test_a_common_scale_counts_for_the_class_and_not_for_the_order():
    E, sd = np.array([0.29, 0.31]), np.array([0.003, 0.003])
    plain = standings(E, sd, np.zeros(2), classes=CLASSES, rng=np.random.default_rng(1))
    wide = standings(E, sd, np.zeros(2), scale_sd_MPa=0.1 * E, classes=CLASSES, rng=np.random.default_rng(1))
    assert [s.p_softer_than_next for s in wide] == [s.p_softer_than_next for s in plain]
    assert [s.rank_probability for s in wide] == [s.rank_probability for s in plain]
    assert plain[0].maturity_probability > 0.99
    expected = norm.cdf((np.log(0.3) - np.log(0.29)) / np.hypot(0.1, 0.003 / 0.29))
    assert wide[0].maturity_probability == pytest.approx(expected)


def test_far_apart_fruit_have_certain_ranks_the_softest_first():
    standings = stand([10.0, 0.1, 1.0], [0.5, 0.005, 0.05])
    assert [s.rank for s in standings] == [3, 1, 2]
    for s in standings:
        assert s.rank_probability == 1.0
        assert s.rank_low == s.rank_high == s.rank


def test_probability_of_being_softer_agrees_with_direct_sampling():
    E, sd = np.array([0.50, 0.55]), np.array([0.05, 0.04])
    softer = stand(E, sd)[0].p_softer_than_next
    draws = np.exp(np.random.default_rng(3).normal(np.log(E), sd / E, (400_000, 2)))
    assert softer == pytest.approx((draws[:, 0] < draws[:, 1]).mean(), abs=0.003)


def test_rank_probability_of_two_equals_probability_of_being_softer():
    first, second = stand([0.50, 0.52], [0.05, 0.05])
    assert first.rank_probability == pytest.approx(first.p_softer_than_next, abs=0.03)
    assert second.p_softer_than_next is None


def test_equal_fruit_get_distinct_ranks_and_even_odds():
    first, second = stand([0.5, 0.5], [0.05, 0.05])
    assert {first.rank, second.rank} == {1, 2}
    assert first.p_softer_than_next == pytest.approx(0.5)


def test_an_error_that_all_fruit_share_leaves_the_order_sure_and_the_class_unsure():
    alone = stand([0.29, 0.31], [0.05, 0.05])
    shared = stand([0.29, 0.31], [0.05, 0.05], common=0.0499)
    assert shared[0].p_softer_than_next > 0.99 > alone[0].p_softer_than_next
    assert shared[0].maturity_probability == pytest.approx(alone[0].maturity_probability)


def test_without_classes_there_is_no_maturity():
    assert maturity(0.0, 0.1, ()) == (None, None)


def test_no_fruit_gives_no_standing():
    assert stand([], []) == []


def test_correlation_with_shore_is_one_for_the_same_order():
    correlation = agreement(np.array([0.1, 0.4, 0.9, 1.5]), np.array([20.0, 35.0, 60.0, 61.0]))
    assert correlation.spearman == pytest.approx(1.0)
    assert correlation.n == 4
    # Two of the 24 orders agree as well: this one and its reverse
    assert correlation.p == pytest.approx(2 / 24)


def test_two_fruit_or_a_constant_reference_have_no_correlation():
    assert agreement(np.array([0.1, 0.4]), np.array([1.0, 2.0])) is None
    assert agreement(np.array([0.1, 0.4, 0.5]), np.array([2.0, 2.0, 2.0])) is None

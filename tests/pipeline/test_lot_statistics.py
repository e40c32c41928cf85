"""Statistics of lots, gauge R&R and the mixed model against other libraries and a printed example."""

import math

import numpy as np
import pytest
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW

from pipeline.history.appraisers import gauge_study
from pipeline.history.lot_statistics import (
    class_ranges,
    lot_differences,
    lot_statistics,
    needed_fruit,
)
from pipeline.history.lots_softening import lots_softening
from pipeline.history.softening import reached, softening_of

AIAG = """
 0.29 -0.56 1.34  0.47 -0.80  0.02  0.59 -0.31 2.26 -1.36
 0.41 -0.68 1.17  0.50 -0.92 -0.11  0.75 -0.20 1.99 -1.25
 0.64 -0.58 1.27  0.64 -0.84 -0.21  0.66 -0.17 2.01 -1.31
 0.08 -0.47 1.19  0.01 -0.56 -0.20  0.47 -0.63 1.80 -1.68
 0.25 -1.22 0.94  1.03 -1.20  0.22  0.55  0.08 2.12 -1.62
 0.07 -0.68 1.34  0.20 -1.28  0.06  0.83 -0.34 2.19 -1.50
 0.04 -1.38 0.88  0.14 -1.46 -0.29  0.02 -0.46 1.77 -1.49
-0.11 -1.13 1.09  0.20 -1.07 -0.67  0.01 -0.56 1.45 -1.77
-0.15 -0.96 0.67  0.11 -1.45 -0.49  0.21 -0.49 1.87 -2.16
"""
"""Readings of the manual's example: three appraisers, three trials each, of ten parts."""


def test_the_manuals_example_has_the_manuals_components():
    readings = np.array(AIAG.split(), dtype=float).reshape(3, 3, 10).transpose(2, 0, 1)
    study = gauge_study(readings)
    components = (study.repeatability, study.reproducibility, study.gauge, study.part)
    assert components == pytest.approx((0.199933, 0.226838, 0.302373, 1.042327), abs=1e-5)
    assert study.percent(study.gauge) == pytest.approx(27.9, abs=0.05)
    assert study.categories == 4


def test_an_interaction_that_is_simulated_is_its_own_component():
    rng = np.random.default_rng(3)
    part, both = rng.normal(0, 2, (400, 1, 1)), rng.normal(0, 0.7, (400, 3, 1))
    study = gauge_study(part + both + rng.normal(0, 0.3, (400, 3, 2)))
    assert (study.repeatability, study.interaction, study.part) == pytest.approx((0.3, 0.7, 2.0), rel=0.1)


def test_no_class_is_dropped_where_one_before_the_last_has_no_limit():
    with pytest.raises(ValueError, match="a class before the last has no upper limit"):
        class_ranges([("ready", None), ("firm", 0.5), ("hard", None)])
    assert class_ranges([]) == []


def test_one_fruit_has_no_spread():
    assert lot_statistics([0.7], precision=0.05).sd_MPa is None
    assert lot_statistics([0.7], precision=0.05).needed is None


def test_so_many_fruit_reach_the_precision_and_one_less_does_not():
    n = needed_fruit(0.8, 0.2, precision=0.1)
    half = {m: DescrStatsW(scaled(m)).tconfint_mean(alpha=0.1)[1] - 0.8 for m in (n - 1, n)}
    assert half[n] <= 0.08 < half[n - 1]
    assert needed_fruit(1.0, 50.0, precision=0.001) is None


def scaled(n):
    """n numbers with mean 0.8 and standard deviation 0.2."""
    x = np.arange(n, dtype=float)
    return 0.8 + 0.2 * (x - x.mean()) / x.std(ddof=1)


def test_lots_differ_as_another_library_says():
    rng = np.random.default_rng(5)
    E = {"A": rng.normal(1.0, 0.1, 10), "B": rng.normal(0.9, 0.3, 14), "C": rng.normal(0.7, 0.1, 9)}
    differences = lot_differences({**E, "single": [1.0]})
    assert [difference.first + difference.second for difference in differences] == ["AB", "AC", "BC"]
    raw = []
    for difference in differences:
        other = CompareMeans(DescrStatsW(E[difference.first]), DescrStatsW(E[difference.second]))
        interval = other.tconfint_diff(alpha=0.1, usevar="unequal")
        assert (difference.low_MPa, difference.high_MPa) == pytest.approx(interval)
        raw.append(other.ttest_ind(usevar="unequal")[1])
    least, middle, largest = sorted(raw)
    by_holm = [3 * least, max(3 * least, 2 * middle), max(3 * least, 2 * middle, largest)]
    assert sorted(difference.p for difference in differences) == pytest.approx(by_holm)
    assert np.argsort([difference.p for difference in differences]).tolist() == np.argsort(raw).tolist()


def test_a_tenth_of_the_fruit_is_there_as_many_spreads_before_the_mean():
    rng, k, spread = np.random.default_rng(2), 0.1, 0.15
    E = {float(t): list(1.2 * np.exp(-k * t + spread * rng.normal(size=4000))) for t in range(12)}
    law = softening_of(E, single_sd=spread)
    mean, tenth = math.log(1.2 / 0.5) / k, (math.log(1.2 / 0.5) - 1.2816 * spread) / k
    assert reached(law, 0.5)[1] == pytest.approx(mean, abs=0.1)
    assert reached(law, 0.5, share=0.1)[1] == pytest.approx(tenth, abs=0.1)


def simulated_lots(rng, *, lots, days=(0.0, 3.0, 6.0, 9.0), fruit=10):
    rates = rng.normal(0.10, 0.03, lots)
    return {
        f"{i}": {t: list(np.exp(-rate * t + rng.normal(0, 0.1, fruit))) for t in days}
        for i, rate in enumerate(rates)
    }


def test_the_rate_of_balanced_lots_is_the_mean_of_their_own_slopes():
    """Generalised and ordinary least squares agree, and the error is the slopes' spread."""
    lots = simulated_lots(np.random.default_rng(7), lots=8)
    slopes = [
        -np.polyfit(np.repeat(list(days), 10), np.log(np.concatenate(list(days.values()))), 1)[0]
        for days in lots.values()
    ]
    law = lots_softening(lots)
    assert law.rate == pytest.approx(np.mean(slopes), rel=1e-4)
    assert law.high - law.rate == pytest.approx(1.6449 * np.std(slopes, ddof=1) / math.sqrt(8), rel=0.02)
    assert np.std(list(law.rates.values())) < np.std(slopes)  # predictions shrink towards the mean


def test_two_lots_have_no_common_rate():
    assert lots_softening(simulated_lots(np.random.default_rng(1), lots=2)) is None

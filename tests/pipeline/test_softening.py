"""How fast a lot softens: the fitted law against simulated lots, closed forms and another library."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import linregress

from pipeline.history.softening import DAY_SD, reached, softening_of


def lot(rng, *, days, k, fruit=12, spread=0.15, day_sd=0.0, E0=1.2):
    return {
        float(day): list(E0 * np.exp(-k * day + day_sd * rng.normal() + spread * rng.normal(size=fruit)))
        for day in days
    }


def test_fruit_without_spread_give_the_law_back():
    law = softening_of({t: [1.2 * math.exp(-0.1 * t)] * 3 for t in (0.0, 2.0, 5.0, 9.0)}, single_sd=0.05)
    assert law.rate() == pytest.approx(0.1, rel=1e-6)
    assert reached(law, 0.6)[1] == pytest.approx(math.log(2) / 0.1, abs=0.01)


def test_equal_days_are_least_squares_by_another_library():
    rng = np.random.default_rng(3)
    E = lot(rng, days=(0, 2, 4, 7), k=0.08, day_sd=0.1)
    days = np.array(sorted(E))
    other = linregress(days, [np.log(E[day]).mean() for day in days])
    assert softening_of(E, single_sd=0.1).rate() == pytest.approx(-other.slope, rel=1e-6)


def test_one_tau_is_fieller():
    law = softening_of(lot(np.random.default_rng(8), days=(0, 2, 5), k=0.1), single_sd=0.1)
    single_tau = replace(
        law, weights=np.ones(1), a=law.a[:1], k=law.k[:1], covariance=law.covariance[:1], last=20.0
    )
    (a,), (k,), ((Vaa, Vak), (_, Vkk)) = single_tau.a, single_tau.k, single_tau.covariance[0]
    away, q = a - math.log(0.5), 1.6448536
    ends = np.roots([k**2 - q**2 * Vkk, -2 * (away * k - q**2 * Vak), away**2 - q**2 * Vaa])
    earliest, _, latest = reached(single_tau, 0.5)
    assert [earliest, latest] == pytest.approx(sorted(ends), abs=0.01)


@pytest.mark.parametrize("days", [(0, 3), (0, 2, 4), (0, 1, 2, 4, 7)])
def test_nine_intervals_in_ten_hold_the_rate_and_the_day(days):
    rng = np.random.default_rng(11)
    k, held, on_day, known = 0.12, 0, 0, 0
    true_day = math.log(1.2 / 0.5) / k
    for _ in range(300):
        drawn = lot(rng, days=days, k=k, day_sd=abs(rng.normal(scale=DAY_SD)))
        law = softening_of(drawn, single_sd=0.15)
        held += law.rate(0.05) <= k <= law.rate(0.95)
        earliest, _, latest = reached(law, 0.5)
        known += latest is not None
        low, high = (np.inf if day is None else day for day in (earliest, latest))
        on_day += min(low, law.farthest_day) <= true_day <= high
    assert 0.85 <= held / 300 <= 0.95
    assert on_day / 300 >= 0.85
    assert known >= (0 if len(days) == 2 else 60)


def test_a_lot_that_does_not_soften_has_no_day():
    rng = np.random.default_rng(5)
    law = softening_of(lot(rng, days=(0, 2, 5), k=0.0), single_sd=0.1)
    assert not law.softens
    assert reached(law, 0.5)[1] is None
    assert softening_of({0.0: [1.0, 1.1]}, single_sd=0.1) is None  # one day

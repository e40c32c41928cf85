"""What is a rupture and what is none: falls of the force by closed forms and by another solver."""

import numpy as np
import pytest
from injected_presses import RADIUS_MM, Press, injected

from fem.fem_failure import FemFailure
from fem.indentation.ball import Ball
from fem.indentation.trace import IndenterTrace, before_rupture


def rupture(time, force, travel, *, noise_N=0.003):
    trace = IndenterTrace(time_s=time, force_N=force, travel_mm=travel, geometry=Ball(radius_mm=RADIUS_MM))
    return before_rupture(trace, noise_N=noise_N)[1]


def ramp(rate_hz=25.0):
    time = np.arange(0, 7, 1 / rate_hz)
    travel = 0.8 * np.maximum(time - 0.2, 0) / 6
    noise = 0.003 * np.random.default_rng(6).standard_normal(len(time))
    return time, 2 * travel**1.5 + noise, travel


@pytest.mark.parametrize(
    "pressing",
    [
        {"g": (0.7,), "tau_s": (0.2,), "press": Press(ramp_s=1.0, rate_hz=20.0)},
        {"g": (0.4,), "tau_s": (5.0,), "press": Press(ramp_s=0.5, rate_hz=50.0)},
        {"law": "plastic_set yield_over_E=0.05", "press": Press(rate_hz=20.0)},
        {"law": "damage dmax=0.5 W0_over_E=0.01", "press": Press(rate_hz=20.0)},
        {"noise_N": 0.1, "press": Press(rate_hz=20.0)},
    ],
)
def test_no_relaxation_and_no_way_back_is_taken_for_a_rupture(pressing):
    for seed in range(5):
        columns = injected(np.random.default_rng(seed), **pressing)
        assert rupture(*columns, noise_N=pressing.get("noise_N", 0.002)) == ""


@pytest.mark.parametrize("late", [1, 2])
def test_a_quick_way_back_whose_travel_is_read_late_is_no_rupture(late):
    time = np.arange(0, 12, 0.04)
    travel = np.interp(time, [0, 8, 8.8, 12], [0, 0.8, 0, 0])
    noise = 0.003 * np.random.default_rng(6).standard_normal(len(time))
    read = np.r_[np.full(late, travel[0]), travel[:-late]]
    assert rupture(time, 2 * travel**1.5 + noise, read) == ""


@pytest.mark.parametrize("factor", [0.4, 1.8])
def test_one_frame_that_reads_low_or_high_is_no_rupture(factor):
    time, force, travel = ramp()
    force[120] *= factor
    assert rupture(time, force, travel) == ""


def test_a_rupture_at_once_leaves_too_little_and_says_so():
    time, force, travel = ramp(rate_hz=10.0)
    with pytest.raises(FemFailure, match=r"found a rupture after \d+ frames .* at least 20 before it"):
        rupture(time, force * np.where(time > 1.7, 0.3, 1.0), travel)

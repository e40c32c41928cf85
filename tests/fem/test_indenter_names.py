"""Names that may be given of a trace: closed-form presses (Hertz's F = 4/3 E/(1 - nu^2) sqrt(R) d^1.5)."""

import numpy as np
import pytest
from injected_presses import NU, RADIUS_MM, THICK_MM, Press, injected
from press_trace import ball_trace

from fem.fem_failure import FemFailure
from fem.indentation.account import account_for
from fem.indentation.rupture import find_rupture

E_MPa, RADIUS = 0.3, 20.0


def hertz_N(depth_mm, *, E_MPa=E_MPa):
    return 4 / 3 * E_MPa / (1 - NU**2) * np.sqrt(RADIUS) * np.maximum(depth_mm, 0) ** 1.5


def ramp(rng, *, air_s=1.0, ramp_s=6.0, hold_s=0.0, depth_mm=0.8, rate_hz=25.0, noise_N=0.003):
    """Times, travel from zero, depth and noise of a ball driven in at constant speed after `air_s`."""
    time = np.arange(0, air_s + ramp_s + hold_s, 1 / rate_hz)
    depth = np.minimum((time - air_s) * depth_mm / ramp_s, depth_mm)
    return time, depth - depth[0], depth, noise_N * rng.standard_normal(len(time))


def account(time, force, travel, *, radius_mm=RADIUS, thickness_mm=None, drift_N_per_min=None):
    trace = ball_trace(time, force, travel, radius_mm=radius_mm, drift_N_per_min=drift_N_per_min)
    return account_for(trace, thickness_mm=thickness_mm, poisson_ratio=NU, rng=np.random.default_rng(0))


def test_hertz_alone_is_nothing_missing_and_zero_and_onset_are_reported_side_by_side():
    time, travel, depth, noise = ramp(np.random.default_rng(1))
    said = account(time, hertz_N(depth) + 0.05 + noise, travel).explanation
    assert said.verdict == "none"
    assert said.withheld is None
    assert said.after.value == pytest.approx(E_MPa, rel=0.03)
    found = said.ranking[0].parameters
    assert found["zero_N"].value == pytest.approx(0.05, abs=4 * found["zero_N"].sd + 0.003)
    assert any("with the load cell at 0.0" in note for note in said.notes)


def test_a_drift_that_the_air_shows_is_named():
    """Of a load cell whose class allows a tenth of it."""
    time, travel, depth, noise = ramp(np.random.default_rng(2), air_s=6.0, hold_s=6.0)
    said = account(time, hertz_N(depth) + 0.03 * time + noise, travel, drift_N_per_min=0.18).explanation
    assert said.verdict == "sensor_drift"
    assert said.ranking[0].parameters["newton_per_s"].value == pytest.approx(0.03, rel=0.1)
    assert said.after.value == pytest.approx(E_MPa, rel=0.03)


def test_a_drift_that_the_cell_cannot_have_is_not_named_in_a_ramp():
    """Stiffening flesh in one ramp, in which time is travel: a large drift would fit too."""
    time, travel, depth, noise = ramp(np.random.default_rng(3), air_s=0.0, depth_mm=4.0)
    force = hertz_N(depth) * np.exp(1.5 * depth / RADIUS)
    said = account(time, force + noise, travel).explanation
    names = (said.verdict,) if isinstance(said.verdict, str) else said.verdict
    assert not any("sensor_drift" in name for name in names)
    assert sum(c.probability for c in said.ranking if "sensor_drift" in c.effect) < 0.05


def test_a_drift_that_the_cell_may_have_is_in_the_error_bar_of_a_single_ramp():
    time, travel, depth, noise = ramp(np.random.default_rng(3), air_s=0.0)
    force = hertz_N(depth) + noise
    sure = account(time, force, travel, drift_N_per_min=1e-4).explanation
    for drift_N_per_min in (-1.0, 1.0):
        said = account(time, force + drift_N_per_min * time / 60, travel, drift_N_per_min=1.0).explanation
        assert said.after.sd > 2 * sure.after.sd
        assert abs(said.after.value - E_MPa) < 2 * said.after.sd


@pytest.mark.parametrize(("hold_s", "fall_s", "noise_N"), [(2.0, 8.0, 0.1), (0.0, 0.0, 0.01)])
def test_flesh_that_relaxes_a_little_gives_E_held_or_not(hold_s, fall_s, noise_N):
    """Flesh that relaxes by a tenth within 2 s: a press with hold and way back gives its initial modulus; one
    ramp, which cannot show relaxation, a modulus between the relaxed and the initial one.
    """
    step, tau_s, share = 0.05, 2.0, 0.1
    time = np.arange(0, 8 + hold_s + fall_s, step)
    travel = np.interp(time, [0, 8, 8 + hold_s, 8 + hold_s + fall_s], [0, 2, 2, 0 if fall_s else 2])
    elastic = hertz_N(travel - 0.5 * bool(hold_s), E_MPa=1.0)
    fading = np.zeros(len(time))
    for k, rise in enumerate(np.diff(elastic), 1):
        fading[k] = fading[k - 1] * np.exp(-step / tau_s) + rise
    force = (1 - share) * elastic + share * fading
    force = force + noise_N * np.random.default_rng(1).standard_normal(len(time))
    said = account(time, force, travel).explanation
    assert said.withheld is None
    relaxed = 1.0 if hold_s else 1.0 - share
    assert relaxed - 2 * said.after.sd < said.after.value < 1.0 + 2 * said.after.sd
    assert said.after.sd < 0.15


@pytest.mark.parametrize("left", [pytest.param(0.3, marks=pytest.mark.proof), 0.7])
def test_a_rupture_is_recognised_and_the_trace_is_cut_before_it(left):
    time, travel, depth, noise = ramp(np.random.default_rng(4), hold_s=2.0)
    force = hertz_N(depth) * np.where(time > 5.5, left, 1.0)
    found = account(time, force + noise, travel)
    assert found.trace.time_s[-1] == pytest.approx(5.5, abs=0.05)
    assert found.explanation.verdict == "none"
    assert found.explanation.after.value == pytest.approx(E_MPa, rel=0.04)
    assert found.explanation.notes[0].startswith("Rupture: at 5.")


@pytest.mark.proof
def test_a_rupture_of_the_injected_press_leaves_the_modulus_of_what_came_before():
    time, force, travel = injected(np.random.default_rng(5), puncture=0.3, press=Press(rate_hz=20.0))
    found = account(time, force, travel, radius_mm=RADIUS_MM, thickness_mm=THICK_MM)
    assert found.explanation.notes[0].startswith("Rupture")
    assert found.trace.travel_mm[-1] < 1.4
    assert found.explanation.after.value == pytest.approx(0.3, rel=0.05)


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
        trace = ball_trace(*injected(np.random.default_rng(seed), **pressing))
        assert find_rupture(trace, noise_N=pressing.get("noise_N", 0.002)) is None


@pytest.mark.parametrize("late", [1, 2])
def test_a_quick_way_back_whose_travel_is_read_late_is_no_rupture(late):
    time = np.arange(0, 12, 0.04)
    travel = np.interp(time, [0, 8, 8.8, 12], [0, 0.8, 0, 0])
    read = np.r_[np.full(late, travel[0]), travel[:-late]]
    noise = 0.003 * np.random.default_rng(6).standard_normal(len(time))
    trace = ball_trace(time, hertz_N(travel) + noise, read, radius_mm=RADIUS)
    assert find_rupture(trace, noise_N=0.003) is None


def test_one_frame_that_reads_low_or_high_is_no_rupture():
    time, travel, depth, noise = ramp(np.random.default_rng(6))
    force = hertz_N(depth) + noise
    for factor in (0.4, 1.8):
        spiked = force.copy()
        spiked[120] *= factor
        trace = ball_trace(time, spiked, travel, radius_mm=RADIUS)
        assert find_rupture(trace, noise_N=0.003) is None


def test_a_rupture_at_once_leaves_too_little_and_says_so():
    time, travel, depth, noise = ramp(np.random.default_rng(7), air_s=0.2, rate_hz=10.0)
    force = hertz_N(depth) * np.where(time > 1.7, 0.3, 1.0) + noise
    with pytest.raises(FemFailure, match=r"found a rupture after \d+ frames .* at least 20 before it"):
        account(time, force, travel)


def test_what_no_law_explains_is_unknown_and_its_E_is_withheld():
    time, travel, depth, noise = ramp(np.random.default_rng(8), air_s=2.0, ramp_s=8.0)
    jerks = np.exp(0.8 * np.sin(3.0 * time) + np.maximum(time - 6, 0) * 0.9)
    said = account(time, hertz_N(depth) * jerks + noise, travel).explanation
    assert said.verdict == "unknown"
    assert said.withheld is not None
    assert np.isnan(said.before.value)
    assert np.isnan(said.after.value)
    assert all(c.modulus is None for c in said.ranking)


@pytest.mark.proof
def test_a_press_that_began_in_contact_has_the_modulus_of_its_flesh():
    rng = np.random.default_rng(9)
    time = np.arange(0, 8, 0.04)
    travel = np.minimum(0.8 * time / 6, 0.8)
    force = hertz_N(travel + 0.3) + 0.003 * rng.standard_normal(len(time))
    said = account(time, force, travel).explanation
    assert said.after.value == pytest.approx(E_MPa, rel=0.1)

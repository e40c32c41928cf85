import numpy as np
import pytest
from injected_presses import NU, RADIUS_MM, THICK_MM, Press, curve, ting_force
from scipy.optimize import brentq
from scipy.special import dawsn

from fem.indentation.ball import Ball, slab_factor
from fem.indentation.foundation import Springs
from fem.solid.closed_forms import hertz_sphere_force_N

HALF_SPACE = Ball(radius_mm=RADIUS_MM).curve(thickness_mm=None, poisson_ratio=NU)


def row(time_s, depth_mm, g=(), tau_s=(), curve=HALF_SPACE.force_N_per_MPa):
    """Force per MPa of one row of springs."""
    depth = np.asarray(depth_mm)[None]
    springs = Springs.of(curve, depth.max(axis=1))
    if not g:
        return springs.elastic_force(depth)[0]
    share, tau = np.array(g)[:, None], np.array(tau_s)[:, None]
    return springs.relaxing_force(time_s, depth, None, share, tau)[0]


def test_a_shallow_press_of_a_thick_slab_is_hertz():
    thick = Ball(radius_mm=5.0).curve(thickness_mm=1e4, poisson_ratio=0.3)
    hertz = hertz_sphere_force_N(E_MPa=1.0, poisson_ratio=0.3, radius_mm=5.0, indentation_mm=0.01)
    assert thick.force_N_per_MPa(np.array(0.01)) == pytest.approx(hertz, rel=1e-3)


def test_a_deep_press_stays_below_hertz_as_a_sphere_must():
    deep = HALF_SPACE.force_N_per_MPa(np.array(RADIUS_MM))
    hertz = hertz_sphere_force_N(E_MPa=1.0, poisson_ratio=NU, radius_mm=RADIUS_MM, indentation_mm=RADIUS_MM)
    assert deep / hertz == pytest.approx(0.900, abs=1e-3)


def test_an_incompressible_slab_has_the_published_numbers():
    x = 1e-3
    at = slab_factor(np.array([0, x, 2 * x, 3 * x, 4 * x]), poisson_ratio=0.5)
    terms = np.polynomial.polynomial.polyfit(np.arange(5) * x, at, 4)
    assert terms[:4] == pytest.approx([1, 1.133, 1.283, 0.769], rel=2e-3)


def test_the_slab_agrees_with_finite_elements_within_a_hundredth():
    depth, force = curve("linear")
    slab = Ball(radius_mm=RADIUS_MM).curve(thickness_mm=THICK_MM, poisson_ratio=NU)
    assert slab.force_N_per_MPa(depth[2:20]) == pytest.approx(force[2:20], rel=0.01)


def test_springs_without_memory_are_the_curve_itself():
    depth = np.linspace(-0.3, 2.0, 60)
    force = row(None, depth)
    assert force == pytest.approx(HALF_SPACE.force_N_per_MPa(depth), abs=3e-4 * force.max())


def test_a_ramp_into_a_standard_solid_is_the_closed_form():
    def phi(depth):
        return np.maximum(depth, 0) ** 1.5

    time = np.arange(0, 4, 0.02)
    g, tau = 0.5, 0.8
    force = row(time, time, (g,), (tau,), curve=phi)
    root = np.sqrt(time)
    memory = 1.5 * (tau * root - tau**1.5 * dawsn(np.sqrt(time / tau)))
    assert force == pytest.approx((1 - g) * time**1.5 + g * memory, abs=5e-4 * force.max())


def test_a_hold_relaxes_by_each_arms_own_exponential():
    time = np.array([0, 1e-4, *np.linspace(0.1, 20, 50)])
    depth = np.where(time > 0, 1.0, -1e-9)
    force = row(time, depth, (0.3, 0.2), (0.5, 9.0))
    kept = 0.5 + 0.3 * np.exp(-time / 0.5) + 0.2 * np.exp(-time / 9.0)
    assert force[1:] / HALF_SPACE.force_N_per_MPa(np.array(1.0)) == pytest.approx(kept[1:], rel=3e-4)


@pytest.mark.parametrize(("g", "tau_s"), [((0.4,), (3.0,)), ((0.3, 0.3), (0.5, 12.0))])
def test_unloading_is_tings(g, tau_s):
    press = Press(onset_mm=0.0)
    force = row(press.time_s, press.depth(press.time_s), g, tau_s)
    ting = ting_force(press.time_s, press.depth, HALF_SPACE.force_N_per_MPa, g, tau_s)
    assert force == pytest.approx(ting, abs=3e-3 * force.max())


def test_contact_ends_when_tings_integral_says():
    g, tau, turn = 0.5, 2.0, 3.0
    time = np.arange(0, 6, 0.01)
    force = row(time, turn - np.abs(time - turn), (g,), (tau,))

    def left(end):
        fading = np.exp(-(end - turn) / tau) - np.exp(-end / tau) - (1 - np.exp(-(end - turn) / tau))
        return (1 - g) * (2 * turn - end) + g * tau * fading

    assert time[force > 1e-9][-1] == pytest.approx(brentq(left, turn, 2 * turn), abs=0.03)


def test_a_second_press_meets_less_until_the_dent_has_come_back():
    time = np.arange(0, 400, 0.1)
    soon = np.interp(time, [0, 2, 12, 14, 15, 17], [0, 2, 2, 0, 0, 2])
    late = np.interp(time, [0, 2, 12, 14, 380, 382], [0, 2, 2, 0, 0, 2])
    first = row(time, soon, (0.5,), (8.0,))
    again = row(time, late, (0.5,), (8.0,))
    assert first[time.searchsorted(16)] < 0.9 * first[time.searchsorted(1)]
    assert again[time.searchsorted(382)] == pytest.approx(again[time.searchsorted(2)], rel=1e-3)


def test_nothing_ever_pulls_on_the_ball():
    time = np.arange(0, 30, 0.1)
    depth = 1.5 * np.sin(time) + 0.3 * np.sin(3.1 * time)
    assert row(time, depth, (0.4, 0.2), (0.7, 6.0)).min() >= -1e-9

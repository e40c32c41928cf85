import numpy as np
import pytest
from compressed_solid import pressed_slab
from injected_presses import NU, RADIUS_MM, THICK_MM, curve

from fem.indentation.ball import Ball
from fem.indentation.effects.trace_damage import damage_share
from fem.indentation.effects.trace_plastic_set import plastic_slack_mm
from fem.indentation.effects.trace_stiffening import fung_share
from fem.indentation.effects.trace_viscoelastic import viscoelastic_parameters
from fem.indentation.energy_share import half_space, hertz_energy_density
from fem.indentation.foundation import Springs

SLAB = Ball(radius_mm=RADIUS_MM).curve(thickness_mm=THICK_MM, poisson_ratio=NU)


def test_the_curves_are_the_finite_elements_own():
    slab = pressed_slab(nu=NU, ball=RADIUS_MM, thickness=THICK_MM, wide=60.0, contact=3.1)
    depth, force = curve("linear")
    assert slab.force_at(THICK_MM - 1.0) == pytest.approx(np.interp(1.0, depth[:20], force[:20]), rel=0.01)


def test_hertz_energy_in_the_half_space_is_the_work_of_the_force():
    r, z, volume = half_space()
    density = hertz_energy_density(r, z, poisson_ratio=0.4999999)
    assert density @ volume == pytest.approx(32 / 15, rel=4e-3)


@pytest.mark.parametrize("b", [2, 8])
def test_stiffening_follows_finite_elements_within_a_hundredth(b):
    depth, force = curve(f"stiffening b={b}")
    linear = curve("linear")[1]
    share = fung_share({"b": np.array([float(b)])}, SLAB, depth[None])[0]
    assert share[4:20] == pytest.approx(force[4:20] / linear[4:20], rel=0.012)


@pytest.mark.parametrize(("dmax", "W0"), [(0.5, 0.01), (0.4, 0.03)])
def test_damage_follows_finite_elements_in_and_out_again(dmax, W0):
    depth, force = curve(f"damage dmax={dmax} W0_over_E={W0}")
    linear = curve("linear")[1]
    deepest = np.maximum.accumulate(depth)
    unknowns = {"dmax": np.array([dmax]), "W0_over_E": np.array([W0])}
    share = damage_share(unknowns, SLAB, depth[None], deepest[None])[0]
    off = (share * linear - force) / force.max()
    assert np.abs(off).max() < 0.04
    assert share[:20] == pytest.approx(force[:20] / linear[:20], rel=0.04)


@pytest.mark.parametrize("yield_over_E", [0.1, 0.05])
def test_plastic_set_follows_finite_elements_within_a_twentieth(yield_over_E):
    depth, force = curve(f"plastic_set yield_over_E={yield_over_E}")
    springs = Springs.of(SLAB.force_N_per_MPa, np.array([depth.max()]))
    deepest = np.maximum.accumulate(depth)[None]
    unknowns = {"yield_over_E": np.array([yield_over_E])}
    slack = plastic_slack_mm(unknowns, SLAB, deepest, springs.level_mm[:, :-1])
    law_force = springs.elastic_force(depth[None], slack)[0]
    off = (law_force - force) / force.max()
    assert np.sqrt(np.mean(off**2)) < 0.05


def test_shares_and_times_carry_the_unknowns_scatter():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4)) * 0.03
    mean, covariance = np.array([-0.5, -1.0, 0.0, 2.0]), root @ root.T
    parameters = viscoelastic_parameters(mean, covariance)
    draws = rng.multivariate_normal(mean, covariance, size=20000)
    weight = np.exp(draws[:, :2])
    g = weight / (1 + weight.sum(axis=1, keepdims=True))
    tau = np.exp(np.cumsum(draws[:, 2:], axis=1))
    for name, sample in {"g": g[:, 0], "g_2": g[:, 1], "tau_s": tau[:, 0], "tau_2_s": tau[:, 1]}.items():
        assert parameters[name].sd == pytest.approx(sample.std(), rel=0.1)
        assert parameters[name].interval == pytest.approx(np.quantile(sample, [0.05, 0.95]), rel=0.012)


def test_a_curve_that_only_opens_is_elastic_without_memory():
    """Depth falls from the first frame on: with a share of nil the force is that of the springs."""
    time_s, depth = np.arange(5.0), np.array([[1.0, 0.8, 0.6, 0.4, 0.2]])
    springs = Springs(level_mm=np.array([[0.0, 0.3, 1.0]]), curve=np.array([[0.0, 0.6, 2.7]]))
    force = springs.relaxing_force(time_s, depth, None, np.zeros((1, 1)), np.ones((1, 1)))
    expected = 2 * depth + np.maximum(depth - 0.3, 0)
    np.testing.assert_allclose(force, expected, rtol=1e-9)

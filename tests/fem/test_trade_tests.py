"""Simulated tests of firmness against Hertz, axisymmetric elements at finite strain, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from compressed_solid import linear, neo_hookean, spheroid
from fem_shapes import ball

from fem.firmness import simulated_presses as presses_module
from fem.firmness.simulated_presses import (
    DEPTHS,
    SQUEEZES,
    FruitPresses,
    PressCurve,
    SmoothPatch,
    simulated_presses,
    spheroid_presses,
)
from fem.firmness.trade_tests import N_PER_GF, modulus_at, reading, trade_tests
from fem.solid.closed_forms import hertz_sphere_force_N
from fem.solid.linear_solid import UnitModulusSolid

NU, RADIUS_MM = 0.45, 30.0


def simulated(pit_share, *, nu_sd=0.0, pit_sd=0.0, vertices=4000, radius_mm=RADIUS_MM):
    fruit = ball(vertices, semi_axes_mm=np.full(3, radius_mm))
    pit = ball(1200, semi_axes_mm=np.full(3, pit_share * radius_mm))
    return simulated_presses(
        fruit, pit if pit_share else None, poisson_ratio=NU, poisson_ratio_sd=nu_sd, pit_size_sd=pit_sd
    )


@pytest.fixture(scope="module")
def pitted():
    """A ball with a pit, and its variants with another Poisson's ratio and another pit."""
    return simulated(0.4, nu_sd=0.02, pit_sd=0.1)


@pytest.fixture(scope="module")
def solid_ball():
    return simulated(0.0)[0]


def between_plates(law, pit_share, squeezes):
    """N per MPa by axisymmetric elements."""
    solid = spheroid(nu=NU, pit_share=pit_share, round_=34, out=10, law=law)
    return RADIUS_MM**2 * np.array([solid.force_at(1 - x) for x in squeezes])


def hertzian(nu=0.49):
    """A fruit that is Hertz's half-space under either tool: 60 mm between the plates."""
    approach, under = SQUEEZES * 60, DEPTHS * 2.5
    by_plates = [
        hertz_sphere_force_N(E_MPa=1, poisson_ratio=nu, radius_mm=30, indentation_mm=d / 2) for d in approach
    ]
    by_ball = [
        hertz_sphere_force_N(E_MPa=1, poisson_ratio=nu, radius_mm=2.5, indentation_mm=d) for d in under
    ]
    return FruitPresses(
        plates=PressCurve(depth_mm=approach, sampled_N_per_MPa=np.array(by_plates)),
        ball=PressCurve(depth_mm=under, sampled_N_per_MPa=np.array(by_ball)),
        diameters_mm=(60.0, 60.0, 60.0),
        pit_share=0.0,
    )


def named_tests(**conditions):
    return {test.name: test for test in trade_tests(**conditions)}


def test_force_of_a_homogeneous_ball_is_hertz_as_the_squeeze_vanishes(solid_ball):
    """Its other side adds a share that goes with the contact's width, the root of the squeeze."""
    squeezes = np.array([0.01, 0.02, 0.03, 0.05])
    over_hertz = [
        solid_ball.plates.force_N_per_MPa(2 * x * RADIUS_MM)
        / hertz_sphere_force_N(E_MPa=1, poisson_ratio=NU, radius_mm=RADIUS_MM, indentation_mm=x * RADIUS_MM)
        for x in squeezes
    ]
    assert np.polyfit(np.sqrt(squeezes), over_hertz, 1)[1] == pytest.approx(1.0, abs=0.015)


def test_facets_of_a_coarse_mesh_change_no_reading_by_more_than_a_fiftieth(solid_ball):
    """With 600 vertices facets cut corners of 0.1 mm, a sixth of the approach at 2 % of the diameter."""
    coarse = simulated(0.0, vertices=600)[0]
    for test in trade_tests():
        coarse_reading, expected = (test.read(presses, 0.6)[0] for presses in (coarse, solid_ball))
        assert coarse_reading == pytest.approx(expected, rel=0.02), test.name


@pytest.mark.parametrize("pit_share", [0.0, 0.4])
def test_plates_agree_with_axisymmetric_elements_at_small_strain_within_a_hundredth(
    pit_share, pitted, solid_ball
):
    squeezes = (0.01, 0.02, 0.05)
    truth = between_plates(linear, pit_share, squeezes)
    fruit = pitted[0] if pit_share else solid_ball
    forces = [fruit.plates.force_N_per_MPa(2 * RADIUS_MM * x) for x in squeezes]
    assert forces == pytest.approx(truth, rel=0.01)


@pytest.mark.parametrize("pit_share", [0.0, 0.4, pytest.param(0.6, marks=pytest.mark.proof)])
def test_the_error_of_small_strain_at_five_percent_lies_in_the_methods_error(pit_share, pitted, solid_ball):
    truth = between_plates(neo_hookean, pit_share, (0.05,))[0]
    fruit = {0.0: solid_ball, 0.4: pitted[0]}.get(pit_share) or simulated(pit_share)[0]
    depth = 0.1 * RADIUS_MM
    off = fruit.plates.force_N_per_MPa(depth) / truth - 1
    assert abs(off) < 1.5 * fruit.plates_sd(depth)
    assert fruit.plates_sd(depth) < (0.06 if pit_share == 0.6 else 0.03)


def test_table_of_spheroids_and_mesh_tell_the_same_of_a_round_fruit(pitted):
    """The page's curves for other sizes and pits are those of the fruit's own simulation."""
    by_table = spheroid_presses((60.0, 60.0, 60.0), pit_share=0.4, poisson_ratio=NU)
    for test in trade_tests():
        mesh_reading, expected = (test.read(presses, 0.6)[0] for presses in (pitted[0], by_table))
        assert mesh_reading == pytest.approx(expected, rel=0.05 if "ball" in test.name else 0.03), test.name


def test_short_waves_of_the_skin_scatter_the_plates_as_their_error_says(solid_ball, monkeypatch):
    """0.05 mm in waves of 18 mm, as wide as contacts: 0.3 of the skin's error of 0.17 mm. They are laid over
    the patches alone, so that the elements stay the same.
    """
    squeezes = np.array([0.01, 0.02, 0.03, 0.06])
    for name, value in (("DOF_LIMIT", 25_000), ("SQUEEZES", squeezes), ("DEPTHS", np.array([0.1, 0.2]))):
        monkeypatch.setattr(presses_module, name, value)
    vertices, faces = ball(4000, semi_axes_mm=np.full(3, RADIUS_MM))
    places = presses_module._places(vertices)
    mesh = presses_module._mesh((vertices, faces), None, places)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free")
    rng = np.random.default_rng(20)
    depths = 2 * RADIUS_MM * np.array([0.02, 0.05])
    forces = []
    for _ in range(8):
        ways = rng.normal(size=(60, 3))
        ways *= 2 * np.pi / 18.0 / np.linalg.norm(ways, axis=1)[:, None]
        height_mm = 0.05 * np.cos(vertices @ ways.T + rng.uniform(0, 2 * np.pi, 60)).sum(axis=1) / np.sqrt(30)
        wavy = vertices * (1 + height_mm / RADIUS_MM)[:, None]
        plates = tuple(
            SmoothPatch.of(wavy, patch.frame[2], radius_mm=patch.radius_mm) for patch in places.plates
        )
        curve = presses_module._curves(solid, replace(places, plates=plates))[0]
        forces.append([curve.force_N_per_MPa(depth) for depth in depths])
    spread = np.std(forces, axis=0, ddof=1) / np.mean(forces, axis=0)
    wavy_fruit = replace(solid_ball, surface_sd_mm=0.17)
    whole, rest = (np.array([each.plates_sd(d) for d in depths]) for each in (wavy_fruit, solid_ball))
    by_skin = np.sqrt(whole**2 - rest**2)
    assert (by_skin > 0.6 * spread).all()
    assert (by_skin < 2.5 * spread).all()


def test_the_error_under_the_ball_is_that_of_hertz_against_sneddons_exact_sphere(solid_ball):
    """A rigid sphere of radius R on a half-space, contact radius a: depth a L/2 and force over E/(1 - nu^2)
    (a^2 + R^2) L/2 - a R with L = ln((R + a)/(R - a)). Source: Sneddon 1965, Int. J. Eng. Sci. 3, 47-57.
    """
    R = 2.5
    for a in R * np.array([0.5, 0.65, 0.8345]):
        log = np.log((R + a) / (R - a))
        depth, exact = a * log / 2, ((a**2 + R**2) * log / 2 - a * R) / (1 - NU**2)
        hertz = hertz_sphere_force_N(E_MPa=1, poisson_ratio=NU, radius_mm=R, indentation_mm=depth)
        by_shape = np.sqrt(solid_ball.ball_sd(depth) ** 2 - presses_module.METHOD_SD**2)
        assert by_shape == pytest.approx(hertz / exact - 1, rel=0.25)


def test_pit_and_poissons_ratio_make_plates_stiffer_and_widen_the_error(pitted):
    plain, other_nu, larger_pit = (presses.plates.force_N_per_MPa(3.0) for presses in pitted)
    assert other_nu / plain == pytest.approx((1 - 0.45**2) / (1 - 0.47**2), rel=0.01)
    by_table = [
        spheroid_presses((60.0,) * 3, pit_share=share, poisson_ratio=NU).plates.force_N_per_MPa(3.0)
        for share in (0.4, 0.44)
    ]
    assert larger_pit / plain - 1 == pytest.approx(by_table[1] / by_table[0] - 1, rel=0.25)
    value, sd = reading(named_tests()["plates_5pct_N"], pitted, E_MPa=0.6, E_sd_MPa=0.0)
    assert sd > np.hypot(other_nu / plain - 1, larger_pit / plain - 1) * value


def test_apparent_modulus_of_a_hertzian_sphere_is_its_modulus():
    assert named_tests()["s368_5pct_MPa"].read(hertzian(), 0.7)[0] == pytest.approx(0.7, rel=1e-9)


@pytest.mark.parametrize("forces_gf", [(50.0, 350.0), (15.0, 200.0)])
def test_firmtechs_chord_of_a_hertzian_sphere_is_its_closed_form(forces_gf):
    """d = (F/k)^(2/3): the chord grows with either force, as Tetteh et al. found on rubber balls."""
    test = next(
        trade_test for name, trade_test in named_tests(chord_gf=forces_gf).items() if name.startswith("chord")
    )
    k = 0.6 * hertz_sphere_force_N(E_MPa=1, poisson_ratio=0.49, radius_mm=30, indentation_mm=0.5)
    first, last = ((gf * N_PER_GF / k) ** (2 / 3) for gf in forces_gf)
    assert test.read(hertzian(), 0.6)[0] == pytest.approx((forces_gf[1] - forces_gf[0]) / (last - first))
    assert test.name == f"chord_{forces_gf[0]:g}_{forces_gf[1]:g}gf_gf_per_mm"


def test_depth_under_the_ball_is_hertz_solved_for_depth():
    depth_mm = named_tests(ball_N=2.0)["ball_5mm_2N_mm"].read(hertzian(), 0.8)[0]
    force = hertz_sphere_force_N(E_MPa=0.8, poisson_ratio=0.49, radius_mm=2.5, indentation_mm=depth_mm)
    assert force == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "power"), [("plates_2pct_N", 1), ("s368_5pct_MPa", 1), ("chord_50_350gf_gf_per_mm", 2 / 3)]
)
def test_the_error_of_e_goes_into_a_reading_as_hertz_says(name, power, monkeypatch):
    """Force goes with E; depth at a force, and so the slope, with its power 2/3."""
    test = named_tests()[name]
    still = named_tests()[name].__class__(**{**vars(test), "force_sd": lambda *_: 0.0})
    value, sd = reading(still, [hertzian()], E_MPa=0.6, E_sd_MPa=0.006)
    assert sd / value == pytest.approx(0.01 * power, rel=0.01)


def test_a_limit_is_read_at_the_modulus_that_is_found_for_it():
    fruit = spheroid_presses((58.0, 60.0, 62.0), pit_share=0.45, poisson_ratio=NU)
    for test in trade_tests():
        limit = test.read(fruit, 0.42)[0]
        assert modulus_at(test, fruit, limit) == pytest.approx(0.42, rel=1e-6), test.name


def test_what_the_simulation_does_not_reach_has_no_reading():
    fruit = spheroid_presses((24.0, 24.0, 24.0), pit_share=0.4, poisson_ratio=NU)
    tests = named_tests()
    assert np.isnan(reading(tests["chord_50_350gf_gf_per_mm"], [fruit], E_MPa=0.02, E_sd_MPa=0.002)).all()
    assert np.isnan(tests["ball_5mm_1N_mm"].read(fruit, 0.02)[0])
    assert np.isnan(modulus_at(tests["ball_5mm_1N_mm"], fruit, 100.0))


@pytest.mark.parametrize("wrong", [{"chord_gf": (350.0, 50.0)}, {"chord_gf": (-1.0, 5.0)}, {"ball_N": 0.0}])
def test_conditions_that_no_instrument_has_are_refused(wrong):
    with pytest.raises(ValueError, match="expected 0 <= first < second"):
        trade_tests(**wrong)

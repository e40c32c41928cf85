"""Every effect of a trace in every geometry: none of it is the plain curve, and closed forms where there are
some: an even field has the law of a small volume, written down here anew.
"""

import numpy as np
import pytest

from fem.indentation.ball import Ball
from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.compressed_ellipsoid import Ellipsoid
from fem.indentation.contact_law import Law, linear_law
from fem.indentation.explain_trace import explain_trace
from fem.indentation.explanations import forms_of
from fem.indentation.flat_punch import FlatPunch
from fem.indentation.trace import IndenterTrace

NU = 0.45
SLIDING = Cylinder(diameter_mm=10.0, height_mm=10.0, ends="lubricated")
GEOMETRIES = {
    "ball": Ball(radius_mm=5.0),
    "punch": FlatPunch(radius_mm=3.0),
    "sliding cylinder": SLIDING,
    "bonded cylinder": Cylinder(diameter_mm=10.0, height_mm=10.0, ends="bonded"),
    "fruit": Ellipsoid(diameters_mm=(60.0, 58.0, 56.0), axis=1, pit_share=0.4),
}
TIME_S = np.arange(0.0, 12.0, 0.1)
TRAVEL_MM = np.interp(TIME_S, [0, 1, 5, 8, 12], [0, 0, 1.5, 1.5, 0])
NOTHING = {
    "b": 1e-9,
    "dmax": 1e-9,
    "yield_over_E": 1e6,
    "mm_per_N": 1e-12,
    "newton_per_s": 0.0,
    "weight_1": 1e-12,
}
"""Values at which each effect does nothing."""
EFFECTS = ("viscoelastic", "stiffening", "plastic_set", "damage", "gripper_compliance", "sensor_drift")


def scaled(law, **values):
    """Rows of unknowns: E of 1 MPa, touch at 0, no zero, and the effect's as given."""
    known = {"E_MPa": 1.0, "onset_mm": 0.0, "zero_N": 0.0, "bend": 0.0, "toe_mm": 1e-6, **values}

    def on_scale(u):
        value = known.get(u.name)
        if value is None:
            return u.mean
        if u.scale == "log":
            return np.log(value)
        return np.log(value / (1 - value)) if u.scale == "logit" else value

    return np.array([[on_scale(u) for u in law.unknowns]])


def force(geometry, effect=None, travel_mm=TRAVEL_MM, **values):
    trace = IndenterTrace(
        time_s=TIME_S, force_N=np.maximum(travel_mm, 1e-3), travel_mm=travel_mm, geometry=geometry
    )
    law = linear_law(trace, thickness_mm=None, poisson_ratio=NU)
    effects = () if effect is None else forms_of(trace)[effect][:1]
    law = Law(curve=law.curve, baseline=law.baseline, effects=effects)
    return law.force_N(trace, scaled(law, **values))[0]


@pytest.mark.parametrize("name", GEOMETRIES)
@pytest.mark.parametrize("effect", EFFECTS)
def test_none_of_an_effect_is_the_plain_curve_in_every_geometry(name, effect):
    geometry = GEOMETRIES[name]
    curve = geometry.curve(thickness_mm=None, poisson_ratio=NU)
    if effect in curve.without:
        pytest.skip(curve.without[effect])
    plain = force(geometry)
    assert plain == pytest.approx(curve.force_N_per_MPa(TRAVEL_MM), abs=2e-3 * plain.max())
    assert force(geometry, effect, **NOTHING) == pytest.approx(plain, abs=1e-4 * plain.max())


@pytest.mark.parametrize("name", GEOMETRIES)
def test_relaxing_flesh_keeps_its_share_in_a_long_hold_in_every_geometry(name):
    sudden = np.where(TIME_S > 0, 1.0, -1e-9)
    force_N = force(GEOMETRIES[name], "viscoelastic", sudden, weight_1=1.0, tau_1=2.0)
    kept = 0.5 + 0.5 * np.exp(-(TIME_S - 0.05) / 2.0)
    assert force_N[1:] / force(GEOMETRIES[name], None, sudden)[1:] == pytest.approx(kept[1:], rel=0.03)


STRAIN = TRAVEL_MM / 10.0
FUNG = np.exp(3.0 * (STRAIN**2 / 2) * 2 * (1 + NU))
"""Stress exp(b W/mu) times linear, W = E e^2/2 and mu = E/(2 (1 + nu)) of one strain."""
SIMO = 1 - 0.5 * -np.expm1(-(np.maximum.accumulate(STRAIN) ** 2 / 2) / 0.005)


@pytest.mark.parametrize(
    ("effect", "values", "share"),
    [("stiffening", {"b": 3.0}, FUNG), ("damage", {"dmax": 0.5, "W0_over_E": 0.005}, SIMO)],
    ids=["stiffening is Fung's law", "damage is Simo's law"],
)
def test_an_effect_of_an_even_field_is_its_law_itself(effect, values, share):
    expected = force(SLIDING) * share
    assert force(SLIDING, effect, **values) == pytest.approx(expected, abs=5e-3 * expected.max())


def test_an_even_field_flows_at_its_yield_stress_and_keeps_what_it_set():
    force_N = force(SLIDING, "plastic_set", yield_over_E=0.05)
    area = np.pi * 25.0
    assert force_N.max() == pytest.approx(0.05 * area, rel=0.08)
    gone = (TIME_S > 8) & (TRAVEL_MM < 1.5 - 0.5 - 1e-6)
    assert force_N[gone] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sliding cylinder", "fruit", "punch"])
def test_relaxation_is_named_between_plates_and_under_a_punch(name):
    """A hold's exponential written down here; the elastic curve is the geometry's own."""

    def kept(t):
        return 0.6 + 0.4 * np.exp(-t / 4.0)

    rng = np.random.default_rng(3)
    time = np.arange(0.0, 25.0, 0.2)
    travel = np.interp(time, [0, 3, 6, 25], [-0.5, -0.5, 1.5, 1.5])
    curve = GEOMETRIES[name].curve(thickness_mm=None, poisson_ratio=NU)
    fine = np.linspace(0, 25, 4001)
    phi = curve.force_N_per_MPa(np.interp(fine, time, travel))
    rising = np.diff(phi)
    middle = (fine[1:] + fine[:-1]) / 2
    memory = np.array([np.sum(kept(t - middle[middle < t]) * rising[middle < t]) for t in time])
    recorded = 0.3 * memory + 1e-3 * memory.max() * rng.standard_normal(len(time))
    trace = IndenterTrace(time_s=time, force_N=recorded, travel_mm=travel, geometry=GEOMETRIES[name])
    account = explain_trace(trace, thickness_mm=None, poisson_ratio=NU, rng=rng)
    said = account.explanation
    assert said.verdict == "viscoelastic"
    assert account.named.modulus.value == pytest.approx(0.3, rel=0.03)
    assert said.ranking[0].parameters["g"].value == pytest.approx(0.4, rel=0.05)
    assert said.ranking[0].parameters["tau_s"].value == pytest.approx(4.0, rel=0.1)

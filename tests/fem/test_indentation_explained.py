"""Explanations of curves: presses by closed forms (Hertz) and by another solver, alone and together."""

from dataclasses import replace

import numpy as np
import pytest
from injected_presses import NU, RADIUS_MM, THICK_MM, Press, injected

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.ball import Ball
from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.contact_law import Law, linear_law
from fem.indentation.explain_trace import BACK, IN_AIR, SLOWER, explain_trace, next_press
from fem.indentation.explanations import forms_of, posterior, shows_drift
from fem.indentation.fit import SHARE, from_prior
from fem.indentation.no_contact import pooled_noise
from fem.indentation.trace import IndenterTrace, before_rupture, joined
from fem.indentation.trace_effect import TraceEffect, Unknown, unknown
from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import mixture
from fem.mismatch.selection.decision import MISFIT, Weighed, probabilities

E_MPa, RADIUS = 0.3, 20.0


def hertz_N(depth_mm, *, E_MPa=E_MPa):
    return 4 / 3 * E_MPa / (1 - NU**2) * np.sqrt(RADIUS) * np.maximum(depth_mm, 0) ** 1.5


def ramp(seed, *, air_s=1.0, ramp_s=6.0, hold_s=0.0, depth_mm=0.8, rate_hz=25.0):
    """Times, travel from zero, depth and noise of a ball driven in at constant speed after `air_s`."""
    time = np.arange(0, air_s + ramp_s + hold_s, 1 / rate_hz)
    depth = np.minimum((time - air_s) * depth_mm / ramp_s, depth_mm)
    return time, depth - depth[0], depth, 0.003 * np.random.default_rng(seed).standard_normal(len(time))


def account(time, force, travel, *, radius_mm=RADIUS, thickness_mm=None, nu=NU, drift_N_per_min=None):
    trace = IndenterTrace(
        time_s=time,
        force_N=force,
        travel_mm=travel,
        geometry=Ball(radius_mm=radius_mm),
        drift_N_per_min=drift_N_per_min,
    )
    rng = np.random.default_rng(0)
    return explain_trace(trace, thickness_mm=thickness_mm, poisson_ratio=nu, rng=rng)


def of_slab(columns, *, thickness_mm=THICK_MM, nu=NU):
    """Of a press by the other solver."""
    return account(*columns, radius_mm=RADIUS_MM, thickness_mm=thickness_mm, nu=nu)


def names_of(said):
    return (said.verdict,) if isinstance(said.verdict, str) else said.verdict


def test_hertz_alone_is_nothing_missing_and_zero_and_onset_are_reported_side_by_side():
    time, travel, depth, noise = ramp(1)
    said = account(time, hertz_N(depth) + 0.05 + noise, travel).explanation
    assert said.verdict == "none"
    assert not said.detected
    assert said.withheld is None
    assert said.next_grasp is None
    assert said.after.value == pytest.approx(E_MPa, rel=0.03)
    parameters = said.ranking[0].parameters
    assert parameters["zero_N"].value == pytest.approx(0.05, abs=4 * parameters["zero_N"].sd + 0.003)
    assert any("with the load cell at 0.0" in note for note in said.notes)


def test_linear_flesh_of_another_solver_is_nothing_to_report():
    said = of_slab(injected(np.random.default_rng(1), press=Press(rate_hz=5.0))).explanation
    assert said.verdict == "none"
    assert said.before.value == pytest.approx(0.3, rel=0.02)
    assert abs(said.after.value - said.before.value) < said.before.sd


def test_relaxing_flesh_is_named_with_its_share_its_time_and_its_modulus():
    press = Press(rate_hz=5.0, onset_mm=1.0)
    said = of_slab(injected(np.random.default_rng(2), g=(0.4,), tau_s=(5.0,), press=press)).explanation
    top = said.ranking[0]
    assert said.verdict == top.effect == "viscoelastic"
    assert said.p_value < 1e-6
    assert top.parameters["g"].value == pytest.approx(0.4, rel=0.04)
    assert top.parameters["tau_s"].value == pytest.approx(5.0, rel=0.08)
    assert top.parameters["onset_mm"].value == pytest.approx(1.0, abs=0.02)
    assert said.after.value == pytest.approx(0.3, rel=0.03)
    assert said.heldout.rms_before > 5 * said.heldout.rms_after
    assert any("Contact starts late: 1.0" in note for note in said.notes)
    assert sum(c.probability for c in said.ranking) > 0.95


@pytest.mark.proof
@pytest.mark.parametrize(
    ("injecting", "name"),
    [
        ({"law": "damage dmax=0.5 W0_over_E=0.01"}, "damage"),
        ({"law": "plastic_set yield_over_E=0.1"}, "plastic_set"),
        ({"newton_per_s": 0.006}, "sensor_drift"),
        (
            {"law": "stiffening b=8", "g": (0.4,), "tau_s": (4.0,), "noise_N": 0.002},
            "stiffening+viscoelastic",
        ),
    ],
)
def test_effects_of_another_solver_are_named(injecting, name):
    press = Press(rate_hz=5.0, unload="+" not in name)
    said = of_slab(injected(np.random.default_rng(4), press=press, **injecting)).explanation
    assert said.verdict == name
    assert said.where.region == ("tip" if name == "sensor_drift" else "flesh")


def test_a_drift_that_the_air_shows_is_named():
    """Of a load cell whose class allows a tenth of it."""
    time, travel, depth, noise = ramp(2, air_s=6.0, hold_s=6.0)
    said = account(time, hertz_N(depth) + 0.03 * time + noise, travel, drift_N_per_min=0.18).explanation
    assert said.verdict == "sensor_drift"
    assert said.ranking[0].parameters["newton_per_s"].value == pytest.approx(0.03, rel=0.1)
    assert said.after.value == pytest.approx(E_MPa, rel=0.03)


def test_a_drift_that_the_cell_cannot_have_is_not_named_in_a_ramp():
    """Stiffening flesh in one ramp, in which time is travel: a large drift would fit too."""
    time, travel, depth, noise = ramp(3, air_s=0.0, depth_mm=4.0)
    said = account(time, hertz_N(depth) * np.exp(1.5 * depth / RADIUS) + noise, travel).explanation
    assert not any("sensor_drift" in name for name in names_of(said))


def test_a_drift_that_the_cell_may_have_is_in_the_error_bar_of_a_single_ramp():
    time, travel, depth, noise = ramp(3, air_s=0.0)
    force = hertz_N(depth) + noise
    sure = account(time, force, travel, drift_N_per_min=1e-4).explanation
    for drift_N_per_min in (-1.0, 1.0):
        said = account(time, force + drift_N_per_min * time / 60, travel, drift_N_per_min=1.0).explanation
        assert said.before.sd > 2 * sure.before.sd
        assert said.after.sd >= said.before.sd
        assert abs(said.after.value - E_MPa) < 2 * said.after.sd
        assert not any("sensor_drift" in name for name in names_of(said))


def test_a_faulty_cells_drift_is_not_named_in_a_single_ramp():
    """It bends the curve like flesh that softens, and no frame in the air or at rest shows it."""
    time, travel, depth, noise = ramp(3, air_s=0.0, ramp_s=60.0, rate_hz=5.0)
    said = account(time, hertz_N(depth) + 0.6 * time / 60 + noise, travel, drift_N_per_min=0.06).explanation
    assert not any("sensor_drift" in effect.effect for effect in said.ranking)
    assert sum(note.startswith("Sensor drift was not looked for") for note in said.notes) == 1


def pressed_by_hertz(**of_ramp):
    time, travel, depth, noise = ramp(3, rate_hz=5.0, **of_ramp)
    return IndenterTrace(
        time_s=time, force_N=hertz_N(depth) + noise, travel_mm=travel, geometry=Ball(radius_mm=RADIUS)
    )


def test_a_drift_is_shown_by_frames_whose_force_is_no_function_of_a_growing_depth():
    quick = pressed_by_hertz(air_s=0.0, ramp_s=60.0)
    slow = pressed_by_hertz(air_s=0.0, ramp_s=120.0)
    assert not shows_drift(quick)
    assert not shows_drift(joined([quick, quick, quick]))
    assert shows_drift(joined([quick, slow]))
    assert shows_drift(pressed_by_hertz(air_s=10.0, ramp_s=60.0))
    assert shows_drift(pressed_by_hertz(air_s=0.0, ramp_s=60.0, hold_s=10.0))


def test_a_travel_that_repeats_its_coarse_readings_is_no_hold():
    """A reading repeats for 37 frames while the ball moves. A rest is seen if it is twenty times as long."""

    def coarse(trace):
        return replace(trace, travel_mm=np.round(trace.travel_mm / 0.1) * 0.1)

    moving = coarse(pressed_by_hertz(air_s=0.0, ramp_s=60.0))
    held = coarse(pressed_by_hertz(air_s=0.0, ramp_s=60.0, hold_s=200.0))
    assert (np.diff(moving.travel_mm) == 0).mean() > 0.8
    assert set(moving.phases) == {"load"}
    assert not shows_drift(moving)
    assert held.phases.count("hold") > 900
    assert shows_drift(held)


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
    time, travel, depth, noise = ramp(4, hold_s=2.0)
    force = hertz_N(depth) * np.where(time > 5.5, left, 1.0)
    press_account = account(time, force + noise, travel)
    assert press_account.trace.time_s[-1] == pytest.approx(5.5, abs=0.05)
    assert press_account.explanation.verdict == "none"
    assert press_account.explanation.after.value == pytest.approx(E_MPa, rel=0.04)
    assert press_account.explanation.notes[0].startswith("Rupture: at 5.")


def test_what_no_law_explains_is_unknown_and_its_E_is_withheld():
    time, travel, depth, noise = ramp(8, air_s=2.0, ramp_s=8.0)
    jerks = np.exp(0.8 * np.sin(3.0 * time) + np.maximum(time - 6, 0) * 0.9)
    time_s, force_N, travel_mm = injected(np.random.default_rng(5), press=Press(rate_hz=5.0))
    for said in (
        account(time, hertz_N(depth) * jerks + noise, travel).explanation,
        of_slab((time_s, force_N * (1 + 0.3 * np.sin(5 * travel_mm)), travel_mm)).explanation,
    ):
        assert names_of(said)[0] == "unknown"
        assert said.withheld is not None
        assert np.isnan([said.before.value, said.after.value]).all()
        assert all(c.modulus is None for c in said.ranking)


@pytest.mark.proof
def test_a_press_that_began_in_contact_has_the_modulus_of_its_flesh():
    time = np.arange(0, 8, 0.04)
    travel = np.minimum(0.8 * time / 6, 0.8)
    noise = 0.003 * np.random.default_rng(9).standard_normal(len(time))
    said = account(time, hertz_N(travel + 0.3) + noise, travel).explanation
    assert said.after.value == pytest.approx(E_MPa, rel=0.1)


def test_the_next_press_is_what_the_names_differ_in():
    assert next_press(("viscoelastic",)) is None
    assert next_press(("viscoelastic", "stiffening")) == SLOWER
    assert next_press(("none", "plastic_set")) == BACK
    assert next_press(("sensor_drift", "stiffening")) == IN_AIR


def refusal_of(columns, **kind):
    with pytest.raises(FemFailure) as caught:
        of_slab(columns, **kind)
    return caught.value


@pytest.mark.usefixtures("unchecked_shapes")
def test_refusals_say_what_was_found_and_what_to_do():
    time, force, travel = injected(np.random.default_rng(6))
    back = time.copy()
    back[10] = back[9]
    assert "strictly increasing" in refusal_of((back, force, travel)).detail
    assert "forces" in refusal_of((time, force[1:], travel)).detail
    assert "not finite" in refusal_of((time, np.where(time > 5, np.nan, force), travel)).detail
    assert "at least 20" in refusal_of((time[:9], force[:9], travel[:9])).detail
    assert refusal_of((time, force, travel), nu=0.5).problem is FemProblem.BAD_POISSON_RATIO
    assert "thickness -1" in refusal_of((time, force, travel), thickness_mm=-1.0).detail
    noise = np.random.default_rng(7).standard_normal(len(time))
    assert refusal_of((time, noise, travel)).problem is FemProblem.NO_LOAD
    assert "more slowly where the machine" in refusal_of((time, noise, travel)).detail
    nothing = np.zeros(len(time))
    assert "found a force of 0 N in every frame" in refusal_of((time, nothing, travel)).detail
    assert "another column taken for the travel" in refusal_of((time, force, nothing)).detail


def three(**kind):
    """Presses of one slab at three rates, each with its own onset."""
    traces = []
    for seed, (ramp_s, onset_mm) in enumerate(((1.0, 0.2), (4.0, 0.6), (20.0, 0.9))):
        shape = Press(ramp_s=ramp_s, hold_s=4.0, unload=False, rate_hz=10.0, onset_mm=onset_mm)
        time_s, force_N, travel_mm = injected(np.random.default_rng(seed), press=shape, **kind)
        tool = Ball(radius_mm=RADIUS_MM)
        traces.append(IndenterTrace(time_s=time_s, force_N=force_N, travel_mm=travel_mm, geometry=tool))
    return traces


def together(traces):
    rng = np.random.default_rng(0)
    return explain_trace(joined(traces), thickness_mm=THICK_MM, poisson_ratio=NU, rng=rng).explanation


@pytest.mark.slow
def test_rates_together_name_relaxation_with_one_share_time_and_modulus():
    said = together(three(g=(0.4,), tau_s=(3.0,)))
    top = said.ranking[0]
    assert said.verdict == "viscoelastic"
    assert top.parameters["g"].value == pytest.approx(0.4, rel=0.04)
    assert top.parameters["tau_s"].value == pytest.approx(3.0, rel=0.08)
    assert said.after.value == pytest.approx(0.3, rel=0.03)
    for name, onset in (("onset_mm", 0.2), ("onset_mm_2", 0.6), ("onset_mm_3", 0.9)):
        assert top.parameters[name].value == pytest.approx(onset, abs=0.03)
    assert said.heldout.rms_before > 3 * said.heldout.rms_after


@pytest.mark.proof
def test_linear_flesh_pressed_thrice_is_nothing_to_report():
    said = together(three())
    assert said.verdict == "none"
    assert said.after.value == pytest.approx(0.3, rel=0.02)
    assert len({cell.grasp for cell in said.cells}) == 3


def test_a_joined_trace_has_each_recordings_force_and_phases():
    parts = three()
    whole = joined(parts)
    assert joined(parts[:1]) is parts[0]
    law = linear_law(whole, thickness_mm=THICK_MM, poisson_ratio=NU)
    recording_names = [f"{n}{k}" for k in ("", "_2", "_3") for n in ("onset_mm", "zero_N")]
    assert [u.name for u in law.unknowns] == ["E_MPa", *recording_names, "bend", "drift_N_per_min"]
    scaled = np.array([u.mean for u in law.unknowns])
    force = law.force_N(whole, scaled[None])[0]
    second = linear_law(parts[1], thickness_mm=THICK_MM, poisson_ratio=NU)
    second_force = second.force_N(parts[1], scaled[[0, 3, 4, 7, 8]][None])[0]
    assert force[whole.slices[1]] == pytest.approx(second_force)
    assert whole.phases == tuple(phase for part in parts for phase in part.phases)
    assert (np.diff(whole.time_s) > 0).all()


TIME_S = np.linspace(0.0, 8.0, 60)
NOISE_N = 1e-3 * np.random.default_rng(0).standard_normal(60)
TRAVEL_MM = 0.1 * TIME_S - 0.1
TRACE = IndenterTrace(
    time_s=TIME_S,
    force_N=np.maximum(TRAVEL_MM, 0) ** 1.5 + NOISE_N,
    travel_mm=TRAVEL_MM,
    geometry=Ball(radius_mm=5.0),
)

HELD_S = np.linspace(0.0, 24.0, 97)
HELD_MM = np.interp(HELD_S, [0, 1, 8, 16, 23, 24], [-0.1, 0, 0.7, 0.7, 0, -0.1])
HELD = replace(TRACE, time_s=HELD_S, travel_mm=HELD_MM, force_N=np.maximum(HELD_MM, 0) ** 1.5)
"""With a hold and an unloading, in which damage, plastic set and relaxation show."""


@pytest.fixture(scope="module")
def fitted():
    """A fit by its effects and log evidence; E of 1 MPa times `E`; so much of the force left."""
    plain = linear_law(TRACE, thickness_mm=None, poisson_ratio=0.45)
    known = from_prior(plain, TRACE, pooled_noise(TRACE))

    def fit(log_evidence, *names, E=1.0, share=SHARE):
        scale = Unknown(name="x", unit="1", scale="log", mean=0.0, sd=1.0)
        effects = tuple(TraceEffect(name=name, unknowns=(scale,)) for name in names)
        scaled = np.concatenate([[np.log(E)], known.scaled[1:], np.zeros(len(names))])
        return replace(
            known,
            law=Law(curve=plain.curve, baseline=plain.baseline, effects=effects),
            scaled=scaled,
            covariance=1e-4 * np.eye(len(scaled)),
            log_evidence=log_evidence,
            share=share,
        )

    return fit


def test_probabilities_are_those_of_grasps(fitted):
    """Forms count by their mean, the misfit as the square of the share that is left."""
    fits = [fitted(1.0, share=4 * SHARE), fitted(9.0, "slip"), fitted(7.0, "slip"), fitted(2.0, "skin")]
    mean = np.log((np.exp(9.0) + np.exp(7.0)) / 2)
    expected, unknown_ = probabilities(
        [
            Weighed(name="none", gain=0.0, misfit=16 * MISFIT),
            Weighed(name="slip", gain=mean - 1.0, misfit=MISFIT),
            Weighed(name="skin", gain=1.0, misfit=MISFIT),
        ],
        temperature=1.0,
    )
    answer = posterior(fits)
    posterior_probabilities = [answer.probability[name] for name in ("none", "slip", "skin")]
    assert posterior_probabilities == pytest.approx(expected.tolist())
    assert answer.probability["unknown"] == pytest.approx(unknown_)
    assert answer.weights[1] / answer.weights[2] == pytest.approx(np.exp(2.0))


def test_evidence_and_misfit_each_detect_a_mismatch(fitted):
    nothing = posterior([fitted(0.0), fitted(0.0, "slip")])
    assert nothing.detection.p_value > 0.05
    assert nothing.verdict == "none"
    listed = posterior([fitted(0.0), fitted(1.0, "slip")])
    assert listed.verdict == ("slip", "none")
    assert not listed.detected
    speaks = posterior([fitted(0.0), fitted(12.0, "slip")])
    assert speaks.detected
    assert speaks.detection.p_values["effects"] == pytest.approx(np.exp(-12.0))
    assert speaks.verdict == "slip"
    left = posterior([fitted(0.0, share=0.2), fitted(0.0, "slip", share=0.2)])
    assert left.detection.p_values["misfit"] < 1e-6
    assert "unknown" in left.verdict


def test_E_is_the_mixture_over_forms(fitted):
    answer = posterior([fitted(0.0), fitted(30.0, "slip", E=1.0), fitted(30.0, "slip", E=3.0)])
    modulus = answer.candidate("slip").modulus
    assert modulus == mixture([1, 1], [fitted(0.0, E=E).modulus for E in (1.0, 3.0)])
    assert modulus.value == pytest.approx(2.0, rel=1e-3)


def test_the_force_is_that_of_the_laws_that_the_verdict_names(fitted):
    answer = posterior([fitted(0.0), fitted(20.0, "slip", E=2.0)])
    slip = answer.best["slip"]
    assert answer.force_N(TRACE) == pytest.approx(slip.law.force_N(TRACE, slip.scaled[None])[0])


PLATES = replace(
    HELD,
    travel_mm=15 * HELD_MM,
    force_N=20 * HELD.force_N,
    geometry=Cylinder(diameter_mm=50.0, height_mm=30.0, ends="bonded"),
)


@pytest.mark.parametrize(
    ("trace", "name"), [(trace, name) for trace in (HELD, PLATES) for name in forms_of(trace)]
)
def test_every_form_is_an_effect_of_the_catalogue_and_changes_the_force(trace, name):
    plain = linear_law(trace, thickness_mm=None, poisson_ratio=0.45)
    for form in forms_of(trace)[name]:
        assert form.name == SPECS[name].name
        law = Law(curve=plain.curve, baseline=plain.baseline, effects=(form,))
        scaled = np.array([[u.mean + side * u.sd for u in law.unknowns] for side in (-1, 1)])
        bare = plain.force_N(trace, scaled[:, : len(plain.unknowns)])
        assert np.abs(law.force_N(trace, scaled) - bare).max() > 1e-4 * np.abs(bare).max()
        if form.parameters is None and isinstance(trace.geometry, Ball):
            for form_unknown in form.unknowns:
                assert form_unknown.unit == SPECS[name].parameter(form_unknown.name).unit


def test_a_parameter_that_the_effect_does_not_have_is_refused():
    with pytest.raises(KeyError, match="mu"):
        unknown(SPECS["damage"], "mu", scale="log", mean=0.0, sd=1.0)


def rupture(time, force, travel, *, noise_N=0.003):
    trace = IndenterTrace(time_s=time, force_N=force, travel_mm=travel, geometry=Ball(radius_mm=RADIUS_MM))
    return before_rupture(trace, noise_N=noise_N)[1]


def hertz_press(rate_hz=25.0):
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
    time, force, travel = hertz_press()
    force[120] *= factor
    assert rupture(time, force, travel) == ""


def test_a_rupture_at_once_leaves_too_little_and_says_so():
    time, force, travel = hertz_press(rate_hz=10.0)
    with pytest.raises(FemFailure, match=r"found a rupture after \d+ frames .* at least 20 before it"):
        rupture(time, force * np.where(time > 1.7, 0.3, 1.0), travel)

"""Fits of curves, and what a rig does to them: springs in series with Hertz."""

import numpy as np
import pytest
from injected_presses import DEEPEST_MM, NU, RADIUS_MM, THICK_MM, Press, injected

from fem.fem_failure import FemFailure
from fem.indentation import fit as indenter_fit
from fem.indentation.ball import Ball
from fem.indentation.contact_law import Law, linear_law
from fem.indentation.effects.trace_viscoelastic import viscoelastic
from fem.indentation.explain_trace import explain_trace
from fem.indentation.explanations import parameters_of
from fem.indentation.fit import fit, future_frames, predicted_N, share_missed
from fem.indentation.no_contact import NoContactNoise, first_touch, no_contact_noise
from fem.indentation.rig_share import MOST_SHARE, SOFT_RIG_N_PER_MM, rig_share
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import TraceNoise, model_clock


def ball_trace(time_s, force_N, travel_mm):
    """A press of the injected presses' ball as the product reads it."""
    ball = Ball(radius_mm=RADIUS_MM)
    return IndenterTrace(time_s=time_s, force_N=force_N, travel_mm=travel_mm, geometry=ball)


def fitted(trace, *effects, rng):
    no_contact = no_contact_noise(trace, first_touch(trace))
    linear = linear_law(trace, thickness_mm=THICK_MM, poisson_ratio=NU)
    law = Law(curve=linear.curve, baseline=linear.baseline, effects=effects)
    mean, sd = (np.array([getattr(u, k) for u in law.unknowns]) for k in ("mean", "sd"))
    return fit(law, trace, no_contact, mean + 0.7 * sd * rng.standard_normal((16, len(mean))))


def test_banded_noise_is_the_dense_normal():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.05, 0.2, 40))
    wander = rng.uniform(0.5, 2, 40)
    noise = TraceNoise(white_N=0.3, wander_N=wander, clock=3 * time)
    dense = 0.09 * np.eye(40) + np.outer(wander, wander) * np.exp(-3 * np.abs(np.subtract.outer(time, time)))
    residual = rng.standard_normal(40)
    assert noise.solve(residual) == pytest.approx(np.linalg.solve(dense, residual), rel=1e-8)
    log = -0.5 * (residual @ np.linalg.solve(dense, residual) + np.linalg.slogdet(2 * np.pi * dense)[1])
    assert noise.log_likelihoods(residual, np.ones(1))[0] == pytest.approx(log)


def test_a_model_is_looked_at_as_often_however_many_frames_there_are():
    def looks(frames):
        time = np.linspace(0, 20, frames)
        return model_clock(time, np.minimum(time, 5) * np.exp(-0.02 * time), white_N=1e-6)[-1]

    assert looks(200) == pytest.approx(looks(2000), rel=0.02)


@pytest.mark.parametrize("fade", [0.0, 0.6])
def test_noise_in_the_air_is_found_white_or_coloured(fade):
    rng = np.random.default_rng(5)
    noises_N = []
    for _ in range(8):
        trace = ball_trace(*injected(rng, noise_N=0.004, fade=fade, press=Press(air_s=12.0)))
        noises_N.append(no_contact_noise(trace, first_touch(trace)).slow_N)
    assert np.mean(noises_N) == pytest.approx(0.004 * np.sqrt((1 + fade) / (1 - fade)), rel=0.2)


def test_a_load_cell_that_counts_in_steps_is_never_noiseless():
    time, force, travel = injected(np.random.default_rng(1), noise_N=0.0)
    trace = ball_trace(time, np.round(force / 0.01) * 0.01, travel)
    assert no_contact_noise(trace, first_touch(trace)).sd_N == pytest.approx(0.01 / np.sqrt(12), rel=1e-6)


def test_touch_is_found_where_it_is():
    press = Press(onset_mm=1.0)
    trace = ball_trace(*injected(np.random.default_rng(2), press=press))
    assert trace.travel_mm[first_touch(trace)] == pytest.approx(1.0, abs=0.25)


@pytest.mark.proof
def test_nine_tenths_of_the_intervals_hold_the_truth():
    rng = np.random.default_rng(11)
    inside = {"g": [], "tau_s": [], "onset_mm": []}
    ratio = []
    for _ in range(50):
        g, tau = rng.uniform(0.15, 0.55), np.exp(rng.uniform(np.log(0.8), np.log(15)))
        onset = rng.uniform(0.1, 1.0)
        press = Press(ramp_s=rng.uniform(2, 8), onset_mm=onset, unload=False, rate_hz=5.0)
        E = np.exp(rng.uniform(np.log(0.1), np.log(1.0)))
        trace = ball_trace(*injected(rng, E_MPa=E, noise_N=12 * E / 500, press=press, g=(g,), tau_s=(tau,)))
        trace_fit = fitted(trace, viscoelastic(1), rng=rng)
        said = parameters_of(trace_fit)
        ratio.append(np.exp(trace_fit.scaled[0]) / E)
        for name, true in (("g", g), ("tau_s", tau), ("onset_mm", onset)):
            low, high = said[name].interval
            inside[name].append(low <= true <= high)
    assert np.mean(list(inside.values())) == pytest.approx(0.9, abs=0.07)
    assert np.median(ratio) == pytest.approx(1, abs=0.02)


def test_two_arms_are_both_found():
    rng = np.random.default_rng(4)
    press = Press(hold_s=40.0, ramp_s=1.0)
    trace = ball_trace(*injected(rng, noise_N=0.002, press=press, g=(0.3, 0.25), tau_s=(1.0, 15.0)))
    said = parameters_of(fitted(trace, viscoelastic(2), rng=rng))
    assert said["g"].value == pytest.approx(0.3, rel=0.08)
    assert said["g_2"].value == pytest.approx(0.25, rel=0.08)
    assert said["tau_s"].value == pytest.approx(1.0, rel=0.08)
    assert said["tau_2_s"].value == pytest.approx(15.0, rel=0.12)


def test_recovery_after_unloading_is_predicted_from_the_hold():
    rng = np.random.default_rng(6)
    trace = ball_trace(*injected(rng, g=(0.45,), tau_s=(6.0,)))
    no_contact = no_contact_noise(trace, first_touch(trace))
    plain, relaxing = (
        predicted_N(fitted(trace, *effects, rng=rng), trace, no_contact)
        for effects in ((), (viscoelastic(1),))
    )
    assert np.array_equal(np.isfinite(plain), future_frames(trace))
    assert share_missed(plain, trace.force_N) > 5 * share_missed(relaxing, trace.force_N)


def test_a_fit_says_whether_its_search_has_settled(monkeypatch):
    rng = np.random.default_rng(4)
    trace = ball_trace(*injected(rng, g=(0.45,), tau_s=(6.0,)))
    assert fitted(trace, viscoelastic(1), rng=rng).converged
    monkeypatch.setattr(indenter_fit, "STEPS", 1)
    monkeypatch.setattr(indenter_fit, "ENOUGH", -1.0)
    assert not fitted(trace, viscoelastic(1), rng=rng).converged


def test_the_past_does_not_know_the_future():
    rng = np.random.default_rng(8)
    columns = injected(rng, g=(0.45,), tau_s=(6.0,), mm_per_N=0.05, press=Press(rate_hz=5.0))
    trace = ball_trace(*columns)
    late = future_frames(trace)
    changed = ball_trace(columns[0], np.where(late, columns[1][::-1], columns[1]), columns[2])
    no_contact = NoContactNoise(sd_N=0.004, lag1=0.0, frames=29)
    named = fitted(trace, viscoelastic(1), rng=rng)
    forces = [predicted_N(named, recording, no_contact)[late] for recording in (trace, changed)]
    assert forces[0] == pytest.approx(forces[1], abs=1e-3 * DEEPEST_MM)


def hertz_mm(force_N, E_MPa):
    return (np.maximum(force_N, 0) * 3 * (1 - NU**2) / (4 * E_MPa * np.sqrt(RADIUS_MM))) ** (2 / 3)


def pressed(rig_N_per_mm, *, E_MPa=0.5, peak_N=4.0, taken_off=False, share=0.05, wrong=1.0):
    """A press into E on a linear rig; `taken_off`: its give times `wrong`, with this share as its spread."""
    rng = np.random.default_rng(0)
    force = np.r_[np.zeros(25), np.linspace(0, 1, 100) ** 1.5 * peak_N, np.full(15, peak_N)]
    travel = hertz_mm(force, E_MPa) + force / rig_N_per_mm
    travel[:25] = np.linspace(-0.2, -0.01, 25)
    give = wrong * force / rig_N_per_mm
    return IndenterTrace(
        time_s=np.arange(len(force)) / 10,
        force_N=force + 0.004 * rng.standard_normal(len(force)),
        travel_mm=travel - give if taken_off else travel,
        geometry=Ball(radius_mm=RADIUS_MM),
        rig_give_mm=give if taken_off else None,
        rig_sd_mm=share * give if taken_off else None,
    )


def explained(trace, **how):
    rng = np.random.default_rng(0)
    return explain_trace(trace, thickness_mm=None, poisson_ratio=NU, rng=rng, **how).explanation


def test_slopes_are_those_of_springs_in_series():
    force = np.linspace(2, 4, 200)
    object_mm_per_N = np.polyfit(force, hertz_mm(force, 0.5), 1)[0]
    share = rig_share(pressed(10.0, taken_off=True), rig_N_per_mm=None)
    assert share.rig_mm_per_N == pytest.approx(0.1, rel=0.01)
    assert share.rig_sd_mm_per_N == pytest.approx(0.005, rel=0.05)
    assert share.recorded_mm_per_N - share.rig_mm_per_N == pytest.approx(object_mm_per_N, rel=0.05)
    assert share.bound is None


def test_E_is_a_lower_bound_where_the_object_is_within_the_rigs_spread():
    soft = rig_share(pressed(5.0, E_MPa=0.5, taken_off=True), rig_N_per_mm=None)
    hard = rig_share(pressed(5.0, E_MPa=500.0, taken_off=True), rig_N_per_mm=None)
    assert soft.bound is None
    assert hard.bound is not None
    assert "the rig gives 0.2 ± 0.01 mm/N" in hard.bound


def test_a_stated_stiffness_is_a_bound_by_its_share():
    trace = pressed(5.0, E_MPa=500.0)
    assert "of a rig of" not in str(rig_share(trace, rig_N_per_mm=1000.0).bound)
    assert rig_share(trace, rig_N_per_mm=1000.0).bound is None
    bound = rig_share(trace, rig_N_per_mm=5.0).bound
    assert bound is not None
    assert "on a rig of 5 N/mm" in bound
    assert "too low by about" in rig_share(trace, rig_N_per_mm=25.0).notes[0]


def test_with_nothing_known_soft_contacts_raise_no_alarm_and_stiff_ones_say_what_rig_they_need():
    soft = rig_share(pressed(1e6, E_MPa=0.1, peak_N=1.0), rig_N_per_mm=None)
    assert 1 / soft.recorded_mm_per_N < MOST_SHARE * SOFT_RIG_N_PER_MM
    assert (soft.bound, soft.notes) == (None, ())
    stiff = rig_share(pressed(5.0, E_MPa=500.0), rig_N_per_mm=None)
    assert stiff.bound is None
    assert "E holds on a rig of 49 N/mm or more" in stiff.notes[0] or "of 50 N/mm" in stiff.notes[0]


@pytest.mark.slow
def test_the_interval_of_E_holds_the_rigs_error():
    sure = explained(pressed(4.0, taken_off=True, share=0.005))
    off = explained(pressed(4.0, taken_off=True, share=0.1, wrong=1.1))
    assert abs(sure.before.value - 0.5) < 1.645 * sure.before.sd
    assert abs(off.before.value - 0.5) > 0.03
    assert abs(off.before.value - 0.5) < 1.645 * off.before.sd
    assert off.before.sd > 3 * sure.before.sd


@pytest.mark.slow
def test_a_lower_bound_is_said_in_place_of_E_and_lies_below_the_truth():
    said = explained(pressed(4.0, E_MPa=100.0, peak_N=10.0, taken_off=True, share=0.1))
    assert np.isnan(said.after.value)
    assert all(candidate.modulus is None for candidate in said.ranking)
    assert 0.5 < float(said.withheld.split("at least ")[1].split()[0]) < 100.0
    stated = explained(pressed(4.0, E_MPa=100.0, peak_N=10.0), rig_N_per_mm=4.0)
    assert float(stated.withheld.split("at least ")[1].split()[0]) < 100.0


def test_a_give_that_is_no_number_a_frame_is_refused():
    with pytest.raises(FemFailure, match="rig_sd_mm"):
        IndenterTrace(
            time_s=np.arange(30.0),
            force_N=np.zeros(30),
            travel_mm=np.arange(30.0),
            geometry=Ball(radius_mm=5.0),
            rig_give_mm=np.zeros(30),
            rig_sd_mm=np.full(30, np.nan),
        )

import numpy as np
import pytest
from injected_presses import DEEPEST_MM, NU, RADIUS_MM, THICK_MM, Press, injected

from fem.indentation import fit as indenter_fit
from fem.indentation.ball import Ball
from fem.indentation.contact_law import Law, linear_law
from fem.indentation.effects.trace_viscoelastic import viscoelastic
from fem.indentation.explanations import parameters_of
from fem.indentation.fit import fit, future_frames, predicted_N, share_missed
from fem.indentation.no_contact import NoContactNoise, first_touch, no_contact_noise
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

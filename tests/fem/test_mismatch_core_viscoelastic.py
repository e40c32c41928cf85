"""Flesh that relaxes: creep against closed forms and the convolution that defines it, and found again."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from injected_mismatch import E_MPA, TIME_S, injected_case, linear_and_refitted, only_grasp
from pinched_case_model import model_of
from plain_model import case_model

from fem.materials.relaxing_arm import lagging
from fem.mismatch.effects.viscoelastic import EFFECT
from fem.mismatch.signature_variant import ONE_WAY

UNEVEN_S = np.concatenate([[0.0, 0.02, 0.1], np.linspace(0.3, 9.0, 25), [12.0, 20.0, 60.0]])


def test_what_lags_behind_a_ramp_and_a_hold_is_their_closed_form_at_any_steps():
    T, end = 1.7, 3.0
    time = np.unique(np.append(UNEVEN_S, end))
    ramp = np.minimum(time, end)
    lag = lagging((ramp[:, None, None] * np.ones((1, 1, 3))), time, T)[:, 0, 0]
    during = time - T * -np.expm1(-time / T)
    at_end = end - T * -np.expm1(-end / T)
    after = end + (at_end - end) * np.exp(-(time - end) / T)
    np.testing.assert_allclose(lag, np.where(time <= end, during, after), atol=1e-12)


def crept(force: np.ndarray, time_s: np.ndarray, g: float, tau_s: float) -> np.ndarray:
    """Displacement of the law E (1 - g + g exp(-t / tau)) under a force, by its own creep compliance.

    J(t) = 1 + g / (1 - g) (1 - exp(-t / T)), T = tau / (1 - g) (Laplace transform of 1 / (s^2 E(s)));
    sum over the force's straight pieces of slope times the integral of J. What is there at first has been
    there for long.
    """
    T = tau_s / (1 - g)

    def integral(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0)
        return t + g / (1 - g) * (t - T * -np.expm1(-t / T))

    slopes = np.diff(force) / np.diff(time_s)
    grown = [
        slope * (integral(time_s - a) - integral(time_s - b))
        for slope, a, b in zip(slopes, time_s[:-1], time_s[1:], strict=True)
    ]
    return force[0] / (1 - g) + np.sum(grown, axis=0)


def relaxed(unit: np.ndarray, *, g: float, tau_s: float) -> np.ndarray:
    """Displacements of a recording, each of them crept."""
    flat = unit.reshape(len(unit), -1)
    return np.stack([crept(course, TIME_S, g, tau_s) for course in flat.T], axis=1).reshape(unit.shape)


@pytest.mark.parametrize(("g", "tau_s"), [(0.3, 0.4), (0.6, 5.0)])
def test_the_model_creeps_as_the_convolution_says(g, tau_s):
    model = model_of()
    recording = model.grasps[0]
    response = EFFECT.respond(model, {"g": g, "tau_s": tau_s}, ONE_WAY).unit[0]
    plain = recording.tracks.unit_displacement
    time = recording.case.history.time_s
    for marker in (3, 30):
        for way in range(3):
            expected = crept(plain[:, marker, way], time, g, tau_s)
            np.testing.assert_allclose(response[:, marker, way], expected, atol=1e-9)


def test_a_start_has_the_retardation_time_of_its_signature():
    model = model_of()
    signature = EFFECT.signatures(model)[2]
    start = EFFECT.start(model, signature, np.array([0.5]))
    assert start["g"] / (1 - start["g"]) == pytest.approx(0.5)
    assert start["tau_s"] / (1 - start["g"]) == pytest.approx(3.0)


def test_frames_that_were_not_used_are_filled_in_straight_lines_and_nil_in_the_air():
    model, _ = case_model(only_grasp(injected_case(), 0))
    recording = model.grasps[0]
    values = np.random.default_rng(0).normal(size=recording.tracks.position_mm.shape)
    whole = recording.over_all_frames(values)
    np.testing.assert_array_equal(whole[recording.used], values)
    np.testing.assert_array_equal(whole[:3], 0)
    last, before = np.flatnonzero(recording.used)[[5, 3]]
    fewer = recording.used.copy()
    fewer[before + 1 : last] = False
    time, kept = recording.case.history.time_s, whole[fewer]
    filled = replace(recording, used=fewer).over_all_frames(kept)
    share = (time[before + 1] - time[before]) / (time[last] - time[before])
    expected = (1 - share) * whole[before] + share * whole[last]
    np.testing.assert_allclose(filled[before + 1], expected, atol=1e-12)


def test_flesh_that_relaxes_is_found():
    g, tau_s = 0.4, 1.2
    case = only_grasp(injected_case(crept=partial(relaxed, g=g, tau_s=tau_s)), 1)
    _, _, again = linear_and_refitted(case, EFFECT)
    (parameters,) = again.parameters
    assert parameters["g"] == pytest.approx(g, rel=0.06)
    assert parameters["tau_s"] == pytest.approx(tau_s, rel=0.08)
    E = 1 / (again.model.compliance * (1 + again.fit.amounts[0]))
    assert pytest.approx(E_MPA, rel=0.04) == E

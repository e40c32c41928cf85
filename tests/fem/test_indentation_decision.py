"""The decision on a curve's laws is that of grasps: here, what is handed to it and made of it."""

from dataclasses import replace

import numpy as np
import pytest

from fem.indentation.ball import Ball
from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.contact_law import Law, linear_law
from fem.indentation.explanations import forms_of, posterior
from fem.indentation.fit import SHARE, from_prior
from fem.indentation.no_contact import pooled_noise
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, Unknown, unknown
from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import mixture
from fem.mismatch.selection.decision import MISFIT, Weighed, probabilities

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

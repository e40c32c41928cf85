"""The posterior of a curve's laws, from evidences that are written down here."""

from dataclasses import replace

import numpy as np
import pytest
from press_trace import ball_trace
from scipy.stats import norm

from fem.indentation.contact_law import Law
from fem.indentation.fit import fit
from fem.indentation.no_contact import pooled_noise
from fem.indentation.posterior import CONTAINED, OTHER, PRESENT, posterior
from fem.indentation.trace_baseline import linear_law
from fem.indentation.trace_effect import TraceEffect
from fem.indentation.unknowns import Unknown


def effect(name, unknowns=1):
    scales = tuple(
        Unknown(name=f"{name}_{k}", unit="1", scale="log", mean=0.0, sd=1.0) for k in range(unknowns)
    )
    return TraceEffect(name=name, unknowns=scales)


@pytest.fixture(scope="module")
def fitted():
    """A fit by its effects and log evidences; E of 1 MPa times `E`."""
    time = np.linspace(0.0, 8.0, 60)
    travel = 0.1 * time - 0.1
    force = np.maximum(travel, 0) ** 1.5 + 1e-3 * np.random.default_rng(0).standard_normal(60)
    trace = ball_trace(time, force, travel)
    plain = linear_law(trace, thickness_mm=None, poisson_ratio=0.45)
    start = np.array([[u.mean for u in plain.unknowns]])
    known = fit(plain, trace, pooled_noise(trace), start, follow=1)

    def one(log_evidence, *effects, other=-1e3, E=1.0):
        extra = sum(len(effect.unknowns) for effect in effects)
        scaled = np.concatenate([known.scaled, np.zeros(extra)])
        scaled[0] = np.log(E)
        return replace(
            known,
            law=Law(curve=plain.curve, baseline=plain.baseline, effects=effects),
            scaled=scaled,
            covariance=1e-4 * np.eye(len(scaled)),
            jacobian=np.zeros((len(force), len(scaled))),
            log_evidence=log_evidence,
            log_evidence_of_other=other,
        )

    return one


def test_probability_is_prior_times_evidence(fitted):
    answer = posterior([fitted(0.0), fitted(3.0, effect("creep")), fitted(1.0, effect("wear"))])
    both = np.array(
        [(1 - PRESENT) ** 2, np.exp(3.0) * PRESENT * (1 - PRESENT), np.exp(1.0) * PRESENT * (1 - PRESENT)]
    )
    expected = both / both.sum()
    assert answer.probability["none"] == pytest.approx(expected[0], rel=1e-6)
    assert answer.probability["creep"] == pytest.approx(expected[1], rel=1e-6)
    assert answer.probability["wear"] == pytest.approx(expected[2], rel=1e-6)
    ratio = (np.exp(3.0) + np.exp(1.0)) * PRESENT * (1 - PRESENT) * (1 - OTHER)
    assert np.exp(answer.log_odds) == pytest.approx(ratio / (1 - (1 - PRESENT) ** 2 * (1 - OTHER)), rel=1e-6)


def test_forms_of_an_effect_share_its_prior_and_each_further_unknown_halves_it(fitted):
    forms = [fitted(5.0, effect("creep")), fitted(5.0, effect("creep", unknowns=2))]
    answer = posterior([fitted(0.0), *forms])
    single = posterior([fitted(0.0), forms[0]])
    assert answer.probability["creep"] == pytest.approx(single.probability["creep"], rel=1e-9)
    assert answer.weights[1] == pytest.approx(2 * answer.weights[2], rel=1e-9)


def test_the_verdict_is_the_smallest_set_that_holds_the_truth(fitted):
    even = np.log(1 / PRESENT)
    answer = posterior([fitted(0.0), fitted(even, effect("creep")), fitted(even - 9.0, effect("wear"))])
    assert set(answer.verdict) == {"none", "creep"}
    assert sum(answer.probability[name] for name in answer.verdict) >= CONTAINED
    assert posterior([fitted(20.0), fitted(0.0, effect("creep"))]).verdict == "none"


def test_E_is_the_mixture_and_its_interval_ends_at_both(fitted):
    even = np.log((1 - PRESENT) / PRESENT)
    answer = posterior([fitted(0.0, E=1.0), fitted(even, effect("creep"), E=3.0)])
    assert answer.modulus.value == pytest.approx(2.0, rel=1e-3)
    alone = posterior([fitted(0.0, E=1.0)]).modulus.sd
    inner = norm.ppf(0.9) * max(alone, posterior([fitted(0.0, E=3.0)]).modulus.sd)
    assert norm.ppf(0.95) * answer.modulus.sd == pytest.approx(1.0 + inner, abs=0.02)


def test_what_the_catalogue_leaves_unexplained_is_unknown(fitted):
    answer = posterior([fitted(0.0, other=20.0), fitted(0.0, effect("creep"), other=0.0)])
    assert answer.verdict == "unknown"
    assert answer.likeliest.law.name == "none"

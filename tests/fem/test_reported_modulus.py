"""E that is reported: averaged over all explanations by their probabilities."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from fem.mismatch.result import NONE, UNKNOWN, HeldOut, Modulus, mixture
from fem.mismatch.selection.grasp_explanations import Hypothesis
from fem.mismatch.selection.reported_modulus import modulus_by, reported_modulus

PLAIN = Modulus(value=0.4, sd=0.004)
Z = norm.ppf(0.95)


def explanation(
    name: str, probability: float, *, E: float | None = None, change: tuple[float, float] | None = None
) -> tuple[Hypothesis, Modulus | None]:
    """`E` by a refit; `change` (ratio, added spread) by a linear signature."""
    refit = None if E is None else SimpleNamespace()
    known = {"refit": refit, "modulus_change": change}
    hypothesis = Hypothesis(name=name, gain=0.0, probability=probability, **known)
    return hypothesis, None if E is None else Modulus(value=E, sd=0.01)


def reported(
    *explanations: tuple[Hypothesis, Modulus | None],
    verdict: str = "skin",
    heldout: HeldOut | None = None,
    hidden: float = 0.0,
) -> Modulus:
    weighed = [(known.probability, modulus_by(known, E, PLAIN, heldout)) for known, E in explanations]
    return reported_modulus(verdict, weighed, PLAIN, hidden=hidden)


def test_without_a_mismatch_E_is_the_plain_models() -> None:
    modulus = reported(explanation(NONE, 1.0))
    assert (modulus.value, modulus.sd) == (PLAIN.value, pytest.approx(PLAIN.sd))


def test_an_effect_that_was_not_detected_widens_E_and_does_not_move_it() -> None:
    """By hand: 0.2 of the upper component, which has a quarter of the probability, lie above the interval."""
    modulus = reported(explanation(NONE, 0.75), explanation("skin", 0.25, E=0.5), verdict=NONE)
    assert modulus.value == PLAIN.value
    assert modulus.sd * Z == pytest.approx(0.5 + 0.01 * norm.ppf(0.8) - PLAIN.value)


def test_explanations_share_E_by_their_probabilities() -> None:
    """Two components of probability 3/4 and 1/4, 0.1 apart: mean and quantiles of the mixture, by hand."""
    modulus = reported(explanation("skin", 0.6, E=0.3), explanation("poisson_ratio", 0.2, E=0.4))
    assert modulus.value == pytest.approx(0.325)
    assert modulus.sd * Z == pytest.approx(0.4 + 0.01 * norm.ppf(0.8) - modulus.value)


def test_an_explanation_of_little_weight_hardly_widens_E() -> None:
    """The standard deviation of this mixture would be five times as large."""
    modulus = reported(explanation("skin", 0.975, E=0.4), explanation(UNKNOWN, 0.025))
    assert 0.01 < modulus.sd < 0.0115


def test_an_interval_holds_nine_tenths_of_draws() -> None:
    rng = np.random.default_rng(1)
    weights, values, sds = [0.5, 0.3, 0.2], np.array([1, 1.3, 0.6]), np.array([0.1, 0.2, 0.05])
    component = rng.choice(3, size=100_000, p=weights)
    drawn = values[component] + sds[component] * rng.normal(size=len(component))
    modulus = mixture(weights, [Modulus(value=v, sd=s) for v, s in zip(values, sds, strict=True)])
    low, high = np.quantile(drawn, [0.05, 0.95])
    assert modulus.value == pytest.approx(drawn.mean(), abs=3e-3)
    assert modulus.sd * Z == pytest.approx(max(high - modulus.value, modulus.value - low), rel=0.01)


def test_an_effect_that_was_not_refitted_counts_by_its_linear_signature() -> None:
    """By hand: none with 0.4, an effect with 0.5 and 10 % more spread, at odds of 3 to 1."""
    modulus = reported(explanation(NONE, 0.75), explanation("skin", 0.25, change=(1.25, 0.1)))
    sd_skin = math.hypot(1.25 * PLAIN.sd, 0.1 * 0.5)
    assert modulus.value == pytest.approx(0.425)
    high = modulus.value + modulus.sd * Z
    assert 0.75 * norm.cdf(high, 0.4, PLAIN.sd) + 0.25 * norm.cdf(high, 0.5, sd_skin) == pytest.approx(0.95)


@pytest.mark.parametrize(("rms", "spread"), [(0.015, 0.17), (0.05, 0.3)])
def test_unknown_physics_makes_E_uncertain_and_does_not_move_it(rms, spread) -> None:
    heldout = HeldOut(rms_before=rms, rms_after=rms, noise_rms=0.01)
    modulus = reported(explanation(UNKNOWN, 1.0), heldout=heldout)
    assert modulus.value == PLAIN.value
    assert modulus.sd == pytest.approx(math.hypot(PLAIN.sd, spread * PLAIN.value))


def test_a_hidden_fault_of_a_gel_widens_E() -> None:
    modulus = reported(explanation(NONE, 1.0), hidden=0.03)
    assert modulus.value == PLAIN.value
    assert modulus.sd == pytest.approx(math.hypot(PLAIN.sd, 0.03 * PLAIN.value))


def test_an_explanation_without_an_E_leaves_the_plain_models() -> None:
    assert reported(explanation("skin", 1.0)) == PLAIN

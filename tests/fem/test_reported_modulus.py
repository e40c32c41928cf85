"""E that is reported: averaged over all explanations by their probabilities."""

import math
from types import SimpleNamespace

import pytest

from fem.mismatch.result import NONE, UNKNOWN, Candidate, HeldOut, Modulus
from fem.mismatch.selection.model_selection import Hypothesis
from fem.mismatch.selection.reported_modulus import reported_modulus

PLAIN = Modulus(value=0.4, sd=0.004)


def explanation(
    name: str, probability: float, *, E: float | None = None, change: tuple[float, float] | None = None
) -> tuple[Hypothesis, Candidate]:
    """`E` by a refit; `change` (ratio, added spread) by a linear signature."""
    refit = None if E is None else SimpleNamespace()
    modulus = None if E is None else Modulus(value=E, sd=0.01)
    hypothesis = Hypothesis(
        name=name,
        gain=0.0,
        probability=probability,
        linear_fits=(),
        refit=refit,  # type: ignore[arg-type]
        modulus_change=change,
    )
    candidate = Candidate(
        effect=name,
        probability=probability,
        parameters={},
        log_evidence=0.0,
        gain=0.0,
        refitted=E is not None,
        modulus=modulus,
    )
    return hypothesis, candidate


def reported(
    *explanations: tuple[Hypothesis, Candidate], verdict: str = "skin", **options: object
) -> Modulus:
    hypotheses, candidates = zip(*explanations, strict=True)
    return reported_modulus(verdict, hypotheses, candidates, PLAIN, **options)  # type: ignore[arg-type]


def test_without_a_mismatch_E_is_the_plain_models() -> None:
    assert reported(explanation(NONE, 1.0)) == PLAIN


def test_an_effect_that_was_not_detected_widens_E_and_does_not_move_it() -> None:
    """By hand: the root mean square of E about the plain one."""
    found = reported(explanation(NONE, 0.75), explanation("skin", 0.25, E=0.5), verdict=NONE)
    assert found.value == PLAIN.value
    assert found.sd**2 == pytest.approx(0.75 * PLAIN.sd**2 + 0.25 * (0.01**2 + 0.1**2))


def test_explanations_share_E_by_their_probabilities() -> None:
    """Two points of probability 3/4 and 1/4, 0.1 apart: mean and variance of the mixture, by hand."""
    found = reported(explanation("skin", 0.6, E=0.3), explanation("poisson_ratio", 0.2, E=0.4))
    assert found.value == pytest.approx(0.325)
    assert found.sd == pytest.approx((0.01**2 + 0.75 * 0.25 * 0.1**2) ** 0.5)


def test_an_effect_that_was_not_refitted_counts_by_its_linear_signature() -> None:
    """By hand: none with 0.4, an effect with 0.5 and 10 % more spread, at odds of 3 to 1."""
    found = reported(explanation(NONE, 0.75), explanation("skin", 0.25, change=(1.25, 0.1)))
    sd_skin = math.hypot(1.25 * PLAIN.sd, 0.1 * 0.5)
    assert found.value == pytest.approx(0.425)
    assert found.sd**2 == pytest.approx(0.75 * PLAIN.sd**2 + 0.25 * sd_skin**2 + 0.75 * 0.25 * 0.1**2)


@pytest.mark.parametrize(("rms", "spread"), [(0.015, 0.17), (0.05, 0.3)])
def test_unknown_physics_makes_E_uncertain_and_does_not_move_it(rms, spread) -> None:
    heldout = HeldOut(rms_before=rms, rms_after=rms, noise_rms=0.01)
    found = reported(explanation(UNKNOWN, 1.0), heldout=heldout)
    assert found.value == PLAIN.value
    assert found.sd == pytest.approx(math.hypot(PLAIN.sd, spread * PLAIN.value))


def test_a_hidden_fault_of_a_gel_widens_E() -> None:
    found = reported(explanation(NONE, 1.0), hidden=0.03)
    assert (found.value, found.sd) == (PLAIN.value, pytest.approx(math.hypot(PLAIN.sd, 0.03 * PLAIN.value)))


def test_an_explanation_without_an_E_leaves_the_plain_models() -> None:
    assert reported(explanation("skin", 1.0)) == PLAIN

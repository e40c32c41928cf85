"""The E that is said with a verdict, and names that recordings left out do not bear out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fem.mismatch.result import NONE, UNKNOWN, Candidate, HeldOut, Modulus
from fem.mismatch.selection import reported_verdict
from fem.mismatch.selection.detection import statistic_p
from fem.mismatch.selection.model_selection import Hypothesis, ModelSelection
from fem.mismatch.selection.null_reference import null_reference
from fem.mismatch.selection.reported_verdict import (
    borne_out,
    fails_held_out,
    reported_modulus,
    undetected_spread,
)
from fem.mismatch.thresholds import P_EXPONENT, TEMPERATURE

PLAIN = Modulus(value=0.4, sd=0.004)


def candidate(effect: str, probability: float, E: float | None) -> Candidate:
    modulus = None if E is None else Modulus(value=E, sd=0.01)
    return Candidate(
        effect=effect,
        probability=probability,
        parameters={},
        log_evidence=0.0,
        gain=0.0,
        refitted=E is not None,
        modulus=modulus,
    )


def test_a_name_that_predicts_worse_than_the_plain_model_is_no_name() -> None:
    assert fails_held_out(HeldOut(rms_before=0.0548, rms_after=0.0581, noise_rms=0.0185), of_fruit=True)
    assert not fails_held_out(HeldOut(rms_before=0.0557, rms_after=0.0205, noise_rms=0.0185), of_fruit=True)


@pytest.mark.parametrize(("after", "fails"), [(0.030, False), (0.035, False), (0.037, True), (0.06, True)])
def test_a_name_that_leaves_more_than_half_of_the_misfit_is_no_name(after, fails) -> None:
    """By hand, in units of the noise: of 25 - 1 half is left at 13, that is at 0.03606."""
    assert fails_held_out(HeldOut(rms_before=0.05, rms_after=after, noise_rms=0.01), of_fruit=True) == fails


@pytest.mark.parametrize(("after", "fails"), [(0.0147, False), (0.0150, True), (0.0160, True)])
def test_a_name_that_leaves_what_sound_recordings_leave_stands(after, fails) -> None:
    """0.011 beside a noise of 0.01 is 0.01487 together; by half of the misfit alone it would be 0.0129."""
    assert fails_held_out(HeldOut(rms_before=0.0153, rms_after=after, noise_rms=0.01), of_fruit=True) == fails


@pytest.mark.parametrize(("after", "fails"), [(0.0112, False), (0.0114, True)])
def test_a_name_that_predicts_worse_than_none_never_stands(after, fails) -> None:
    """Though both are within what sound recordings leave."""
    assert fails_held_out(HeldOut(rms_before=0.0112, rms_after=after, noise_rms=0.01), of_fruit=True) == fails


@pytest.mark.parametrize(("after", "fails"), [(0.049, False), (0.0505, False), (0.051, True)])
def test_a_fault_of_a_sensor_need_only_predict_no_worse(after, fails) -> None:
    assert fails_held_out(HeldOut(rms_before=0.05, rms_after=after, noise_rms=0.01), of_fruit=False) == fails


def test_unknown_physics_with_a_large_misfit_leaves_E_more_uncertain() -> None:
    small = HeldOut(rms_before=0.015, rms_after=0.015, noise_rms=0.01)
    large = HeldOut(rms_before=0.05, rms_after=0.05, noise_rms=0.01)
    of_small, of_large = (reported_modulus(UNKNOWN, [], PLAIN, proof=one).sd for one in (small, large))
    assert of_small == pytest.approx(math.hypot(PLAIN.sd, 0.17 * PLAIN.value))
    assert of_large == pytest.approx(math.hypot(PLAIN.sd, 0.3 * PLAIN.value))


def test_within_noise_or_of_one_recording_held_out_fits_say_nothing() -> None:
    assert not fails_held_out(HeldOut(rms_before=0.0190, rms_after=0.0210, noise_rms=0.0185), of_fruit=True)
    assert not fails_held_out(None, of_fruit=True)


def test_where_nothing_is_missing_E_is_the_plain_models() -> None:
    assert reported_modulus(NONE, [candidate("skin", 0.04, 0.3)], PLAIN) == PLAIN


def fitted(name: str, gain: float, change: float) -> Hypothesis:
    linear = SimpleNamespace(modulus_spread=change)
    return Hypothesis(name=name, gain=gain, probability=0.1, linear_fits=(linear,), refit=None)  # type: ignore[arg-type]


def test_an_effect_that_went_undetected_widens_E_and_does_not_move_it() -> None:
    said = reported_modulus(NONE, [], PLAIN, undetected=0.03)
    assert (said.value, said.sd) == (PLAIN.value, pytest.approx(math.hypot(PLAIN.sd, 0.03 * PLAIN.value)))


def test_what_effects_may_do_counts_by_their_gains_and_by_p() -> None:
    """By hand: two effects, one of them e^2 likelier; odds x p^(x - 1) that there is one at all."""
    ranking = (fitted("pit_size", TEMPERATURE * 2.0, 0.06), fitted("skin", 0.0, -0.02))
    found = ModelSelection(ranking=ranking, verdict=NONE, without={})
    share = math.exp(2.0) / (1 + math.exp(2.0))
    change = math.sqrt(share * 0.06**2 + (1 - share) * 0.02**2)
    for p in (0.06, 0.9):
        ratio = P_EXPONENT * p ** (P_EXPONENT - 1)
        assert undetected_spread(found, p) == pytest.approx(math.sqrt(ratio / (1 + ratio)) * change)
    assert undetected_spread(found, 0.9) < 0.5 * undetected_spread(found, 0.06)
    assert undetected_spread(ModelSelection(ranking=(), verdict=NONE, without={}), 0.06) == 0.0


def test_a_second_effect_beside_a_name_widens_E_too() -> None:
    said = reported_modulus("skin", [candidate("skin", 0.9, 0.3)], PLAIN, undetected=0.03)
    assert (said.value, said.sd) == (0.3, pytest.approx(math.hypot(0.01, 0.03 * 0.3)))


def test_a_second_effects_p_is_that_of_sound_recordings_whose_best_effect_adds_as_much(monkeypatch) -> None:
    """Two signatures of one effect count once, the better; by hand as above."""
    added = [(6.0, "pit_size", 0.06), (5.0, "pit_size", 0.5), (1.0, "skin", -0.02)]
    fits = [(gain, SimpleNamespace(name=name, modulus_spread=change)) for gain, name, change in added]
    monkeypatch.setattr(reported_verdict, "added_gains", lambda *_: fits)
    null_case = SimpleNamespace(compliance_ratio=2.0, excess_gain=lambda _, gain: gain - 0.5)
    p = statistic_p("best single", 5.5 / 2.0)
    ratio = P_EXPONENT * p ** (P_EXPONENT - 1)
    likelier = math.exp(5.0 / TEMPERATURE)
    mean = (likelier * 0.06**2 + 0.02**2) / (1 + likelier)
    found = reported_verdict.second_spread(None, None, null_case)  # type: ignore[arg-type]
    assert found == pytest.approx(math.sqrt(ratio / (1 + ratio) * mean))


def test_a_statistics_p_falls_with_it_and_is_half_in_the_middle_of_sound_fruit() -> None:
    each = [statistic_p("best single", value) for value in (-1.0, 0.5, 3.0, 20.0)]
    assert each == sorted(each, reverse=True)
    assert each[-1] < 0.05 < each[0]
    known = null_reference().statistics[:, 0]
    assert statistic_p("best single", float(np.sinh(np.arcsinh(known).mean()))) == pytest.approx(
        0.5, abs=0.05
    )


def test_where_something_unknown_is_missing_E_is_as_uncertain_as_that() -> None:
    said = reported_modulus(UNKNOWN, [candidate("skin", 0.9, 0.3)], PLAIN)
    assert said.value == PLAIN.value
    assert 0.1 * PLAIN.value < said.sd < 0.3 * PLAIN.value


def test_names_that_cannot_be_told_apart_share_E_by_their_probabilities() -> None:
    """Two points of probability 3/4 and 1/4, 0.1 apart: mean and variance of the mixture, by hand."""
    ranking = [
        candidate("skin", 0.6, 0.3),
        candidate("poisson_ratio", 0.2, 0.4),
        candidate("slip", 0.2, None),
    ]
    said = reported_modulus(("skin", "poisson_ratio"), ranking, PLAIN)
    assert said.value == pytest.approx(0.325)
    assert said.sd == pytest.approx((0.01**2 + 0.75 * 0.25 * 0.1**2) ** 0.5)


def test_one_name_has_its_own_E_and_one_without_a_model_the_plain_ones() -> None:
    assert reported_modulus("skin", [candidate("skin", 0.9, 0.3)], PLAIN) == Modulus(value=0.3, sd=0.01)
    assert reported_modulus("skin", [candidate("skin", 0.9, None)], PLAIN) == PLAIN


def as_refit(proof: object) -> SimpleNamespace | None:
    """A refit of one property of the fruit, with the proof that `proof_of` gives of it."""
    spec = SimpleNamespace(family="object")
    return None if proof is None else SimpleNamespace(effects=(SimpleNamespace(spec=spec),), proof=proof)


def selection(verdict: str | tuple[str, ...], **refits: object) -> ModelSelection:
    """Hypotheses in this order; a refit is whatever `proof_of` knows."""
    ranking = tuple(
        Hypothesis(name=name, gain=9.0, probability=0.4, linear_fits=(), refit=as_refit(again))  # type: ignore[arg-type]
        for name, again in refits.items()
    )
    return ModelSelection(ranking=ranking, verdict=verdict, without={})


PROOFS = {
    "good": HeldOut(rms_before=0.05, rms_after=0.03, noise_rms=0.02),
    "bad": HeldOut(rms_before=0.05, rms_after=0.06, noise_rms=0.02),
}


def proof_of(again: object) -> HeldOut:
    return PROOFS[again.proof]  # type: ignore[attr-defined]


def test_of_names_that_cannot_be_told_apart_only_those_that_predict_stand() -> None:
    found, worse = borne_out(selection(("skin", "slip"), skin="bad", slip="good"), proof_of)
    assert (found.verdict, worse) == ("slip", ("skin",))
    assert [(one.name, one.probability) for one in found.ranking] == [("slip", 1.0), ("skin", 0.0)]


def test_where_no_name_predicts_the_verdict_is_unknown() -> None:
    found, worse = borne_out(selection("skin", skin="bad", slip="good"), proof_of)
    assert (found.verdict, worse) == (UNKNOWN, ("skin",))


def test_names_that_predict_and_sound_fruit_are_left_as_they_are() -> None:
    for before in (selection("skin", skin="good"), selection(NONE, none=None, skin="bad")):
        assert borne_out(before, proof_of) == (before, ())

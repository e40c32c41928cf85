"""Start to end: a fruit grasped twice with a sensor that says too much, solved on another mesh."""

from dataclasses import replace
from functools import partial

import pytest
from injected_mismatch import E_MPA, Recording, injected_case, on_pad

from fem.mismatch import procedure as start_to_end
from fem.mismatch.effects import (
    clock_lag,
    gripper_compliance,
    pit_size,
    sensor_drift,
    sensor_gain,
    skin,
    viscoelastic,
)
from fem.mismatch.mismatch_case import GradedCase
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.result import NINETY, Modulus

PLAIN = Modulus(value=1.1 * E_MPA, sd=0.03 * E_MPA)
"""What another estimate says of E; no part of the answer but where no effect is named."""
SHORT = (viscoelastic, skin, pit_size, sensor_gain, sensor_drift, gripper_compliance, clock_lag)


@pytest.fixture(scope="module")
def answer():
    """Of a catalogue of seven."""

    def louder(pad: Recording) -> Recording:
        return replace(pad, force_N=1.2 * pad.force_N)

    with pytest.MonkeyPatch.context() as patch:
        # flesh here moves by small strain
        patch.setattr(start_to_end, "CaseModel", partial(CaseModel, beyond_small_strain=False))
        patch.setattr(start_to_end, "EFFECTS", tuple(module.EFFECT for module in SHORT))
        return start_to_end.explain(injected_case(on_pad("left", louder)), graded=GradedCase(modulus=PLAIN))


def test_a_pads_gain_is_seen_and_named(answer):
    assert answer.detected
    assert answer.p_value < 1e-3
    assert answer.verdict == "sensor_gain"
    assert answer.ranking[0].effect == "sensor_gain"
    assert answer.ranking[0].probability > 0.9
    with_it = [each.probability for each in answer.ranking if "sensor_gain" in each.effect.split("+")]
    assert sum(with_it) > 0.99
    assert sum(hypothesis.probability for hypothesis in answer.ranking) == pytest.approx(1.0)


def test_its_gain_comes_back_with_an_interval(answer):
    parameters = answer.ranking[0].parameters
    said, gain = parameters["pad"].value, parameters["gain"]
    assert (gain.value if said == "left" else 1 / gain.value) == pytest.approx(1.2, rel=0.02)
    low, high = gain.interval
    assert low < (1.2 if said == "left" else 1 / 1.2) < high < 1.1 * low


def test_the_modulus_without_the_gain_is_the_injected_one(answer):
    """Which of the pads it is cannot be told: with the gain on the other one E is 1.2 of what it is."""
    pad = answer.ranking[0].parameters["pad"].value
    true_MPa, other = (E_MPA, 1.2 * E_MPA) if pad == "left" else (1.2 * E_MPA, E_MPA)
    off = (answer.after.value - true_MPa) / (other - true_MPa)
    assert -0.1 < off < 0.55
    assert NINETY * answer.after.sd >= 0.95 * max(abs(answer.after.value - E) for E in (true_MPa, other))
    assert answer.before == PLAIN


def test_recordings_that_the_fit_did_not_see_are_predicted_better(answer):
    assert answer.heldout.rms_after < answer.heldout.rms_before
    assert answer.heldout.rms_after < 1.5 * answer.heldout.noise_rms
    assert len(answer.traces) == 2

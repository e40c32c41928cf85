"""The catalogue and the finder from start to end: what effects state, their slopes and their searches."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from injected_mismatch import E_MPA, Recording, injected_case, on_pad
from pinched_case_model import model_of
from plain_model import case_model, screened_effects
from refusals import refused

from fem.fem_failure import FemProblem
from fem.mismatch import procedure as start_to_end
from fem.mismatch.catalogue import EFFECTS, SPECS
from fem.mismatch.effect import Effect, Response
from fem.mismatch.effect_spec import Entry, Scope
from fem.mismatch.effects import (
    clock_lag,
    damage,
    gripper_compliance,
    loose_pit,
    pit_size,
    plastic_set,
    pose_error,
    sensor_drift,
    sensor_gain,
    skin,
    slip,
    stiffening,
    viscoelastic,
)
from fem.mismatch.mismatch_case import GradedCase
from fem.mismatch.model import stress_history
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.procedure import TURNED, next_grasp
from fem.mismatch.result import NINETY, Modulus
from fem.mismatch.selection import model_selection
from fem.mismatch.signature_variant import ONE_WAY, Variant, of_pad


def test_ranks_and_names_are_each_effects_own():
    assert len({effect.spec.rank for effect in EFFECTS}) == len(EFFECTS) == len(SPECS)


@pytest.mark.parametrize("effect", EFFECTS, ids=list(SPECS))
def test_every_effect_can_be_read_by_people(effect: Effect):
    words = effect.spec.words
    assert words.short[0].islower()
    assert not words.short.endswith(".")
    assert words.meaning.endswith(".")
    assert words.advice.endswith(".")
    assert all(parameter.words for parameter in effect.spec.parameters)


@pytest.mark.parametrize("effect", EFFECTS, ids=list(SPECS))
def test_what_is_searched_lies_within_what_settings_may_hold(effect: Effect):
    """At the modulus of soft and of firm flesh."""
    for parameter in effect.spec.parameters:
        low, high = parameter.limits
        for spec in parameter.searched:
            for E_MPa in (0.05, 2.0):
                ends = [end * E_MPa**parameter.modulus_power for end in (spec.low, spec.high)]
                assert low <= ends[0] < ends[1] <= high, spec.name


@pytest.mark.parametrize("effect", EFFECTS, ids=list(SPECS))
def test_an_effect_whose_start_is_not_its_amounts_states_its_priors(effect: Effect):
    if type(effect).start is not Effect.start:
        assert type(effect).prior is not Effect.prior


def test_every_effect_of_the_jaws_is_told_from_every_effect_of_the_fruit_by_turning_it():
    jaws = [name for name, spec in SPECS.items() if spec.scope in (Scope.SENSOR, Scope.GRIPPER)]
    fruit = [name for name, spec in SPECS.items() if spec.scope in (Scope.FRUIT, Scope.LOT)]
    assert len(jaws) + len(fruit) == len(SPECS)
    for jaw in jaws:
        for other in fruit:
            assert next_grasp((jaw, other), grasps=4) == TURNED


def test_what_is_wrong_with_the_jaws_is_put_right_in_the_recordings_and_nothing_else_is():
    assert all((spec.enters is Entry.RECORDING) == spec.of_the_jaws for spec in SPECS.values())


CATALOGUE = {effect.spec.name: effect for effect in EFFECTS}


@cache
def flesh() -> CaseModel:
    """A coarse fruit, pinched; the same for all effects of the flesh."""
    return model_of()


@cache
def recordings() -> CaseModel:
    """Two grasps without noise, for effects of sensors and machines."""
    return case_model(injected_case(noise=0.0))[0]


def answer(effect: Effect, model: CaseModel, values: Sequence[float], variant: Variant) -> Response:
    names = [spec.name for spec in effect.spec.searched]
    return effect.respond(model, dict(zip(names, values, strict=True)), variant)


@pytest.mark.parametrize(
    ("name", "model", "variant", "null", "steps", "tolerance"),
    [
        ("skin", flesh, ONE_WAY, (0.0,), (1e-3,), 1e-3),
        ("graded_modulus", flesh, ONE_WAY, (0.0,), (1e-3,), 1e-3),
        ("anisotropy", flesh, ONE_WAY, (0.0,), (1e-3,), 1e-3),
        ("poisson_ratio", flesh, ONE_WAY, (0.45,), (1e-5,), 1e-3),
        ("sensor_gain", recordings, of_pad("left"), (1.0,), (1e-4,), 1e-3),
        ("sensor_drift", recordings, of_pad("right"), (0.0,), (1e-3,), 1e-9),
        ("gripper_compliance", recordings, ONE_WAY, (0.0,), (1e-3,), 1e-9),
        ("clock_lag", recordings, ONE_WAY, (0.0,), (0.05,), 1e-9),
        ("pose_error", recordings, of_pad("left"), (0.0, 0.0, 0.0), (0.15, 0.15, 0.15), 0.03),
    ],
)
def test_each_signature_is_the_slope_of_its_own_model(name, model, variant, null, steps, tolerance):
    effect, model = CATALOGUE[name], model()
    signature = next(way for way in effect.signatures(model) if way.variant == variant)
    for k, step in enumerate(steps):
        two_sided = model is flesh()
        ends = np.array(null) + step * np.eye(len(null))[k] * [[1.0], [-1.0 if two_sided else 0.0]]
        ahead, back = (answer(effect, model, end, variant) for end in ends)
        run = (1 + two_sided) * step
        for grasp, field in enumerate(signature.columns[k].fields):
            slope = model.compliance * (ahead.unit[grasp] - back.unit[grasp])
            if ahead.shift_mm is not None:
                slope = slope + ahead.shift_mm[grasp] - back.shift_mm[grasp]
            assert np.linalg.norm(slope / run - field.markers) <= tolerance * np.linalg.norm(field.markers)
            if ahead.balance is not None:
                unbalanced = (ahead.balance[grasp] - back.balance[grasp]) / run
                off = np.linalg.norm(unbalanced - field.balance)
                assert off <= tolerance * np.linalg.norm(field.balance)
    if len(null) == 1 and model is flesh():
        assert list(effect.start(model, signature, np.zeros(1)).values()) == pytest.approx(null)


@pytest.mark.parametrize("name", ["viscoelastic", "drainage"])
def test_each_signature_of_fading_flesh_is_the_slope_at_its_own_time(name):
    effect, model, small = CATALOGUE[name], flesh(), 1e-5
    for signature in effect.signatures(model):
        more = answer(effect, model, (small, *signature.variant.values), ONE_WAY).unit[0]
        slope = model.compliance * (more - model.plain[0]) / small
        markers = signature.columns[0].fields[0].markers
        assert np.linalg.norm(slope - markers) < 1e-3 * np.linalg.norm(markers)


@pytest.mark.parametrize(
    ("name", "variant", "values"),
    [
        ("sensor_gain", of_pad("left"), (1.0,)),
        ("sensor_drift", of_pad("left"), (0.0,)),
        ("gripper_compliance", ONE_WAY, (0.0,)),
        ("clock_lag", ONE_WAY, (0.0,)),
        ("drainage", ONE_WAY, (0.0, 1.0)),
        ("sensor_nonlinear", ONE_WAY, (0.0,)),
        ("gel_creep", ONE_WAY, (0.0, 0.1)),
        ("gel_hysteresis", ONE_WAY, (0.0,)),
        ("thermal_drift", ONE_WAY, (0.0, 0.0)),
    ],
)
def test_no_amount_of_it_changes_nothing(name, variant, values):
    response = answer(CATALOGUE[name], recordings(), values, variant)
    for grasp, plain in enumerate(recordings().plain):
        np.testing.assert_allclose(response.unit[grasp], plain, atol=1e-6 * np.abs(plain).max())
        for channel in (response.shift_mm, response.balance, response.rest):
            if channel is not None:
                np.testing.assert_allclose(channel[grasp], 0, atol=1e-9)


LAWS = [
    (damage.EFFECT, {"dmax": 0.35, "W0_over_E": 0.004}, {"dmax": 0.3, "W0_over_E": 0.003}),
    (plastic_set.EFFECT, {"yield_over_E": 0.05}, {"yield_over_E": 0.06}),
    (stiffening.EFFECT, {"b": 30.0}, {"b": 25.0}),
]


@pytest.mark.parametrize(
    ("effect", "values", "_"), LAWS, ids=lambda x: x.spec.name if hasattr(x, "spec") else ""
)
def test_a_law_that_is_not_solved_in_its_rounds_says_so(monkeypatch, effect, values, _):
    monkeypatch.setattr(stress_history, "MOST_ROUNDS", 2)
    with refused(FemProblem.NOT_CONVERGED, "after 2 rounds"):
        effect.respond(model_of(), values, ONE_WAY)


@pytest.mark.parametrize(
    ("effect", "values", "others", "variant"),
    [
        *((effect, values, others, ONE_WAY) for effect, values, others in LAWS),
        pytest.param(pit_size.EFFECT, {"scale": 0.8}, {"scale": 0.75}, ONE_WAY, marks=pytest.mark.proof),
        (
            pose_error.EFFECT,
            {"dx_mm": 1.5, "dy_mm": 1.0, "tilt_deg": 2.0},
            {"dx_mm": 1.8, "dy_mm": 1.2, "tilt_deg": 2.2},
            of_pad("left"),
        ),
    ],
    ids=lambda x: x.spec.name if hasattr(x, "spec") else "",
)
def test_the_same_call_gives_the_same_answer_whatever_was_asked_before(effect, values, others, variant):
    model = model_of()
    names = dict(zip([spec.name for spec in effect.spec.searched], values.values(), strict=True))
    before = effect.respond(model, names, variant).unit[0]
    effect.respond(model, dict(zip(names, others.values(), strict=True)), variant)
    np.testing.assert_array_equal(effect.respond(model, names, variant).unit[0], before)


def test_an_effect_whose_model_is_not_found_is_reported_as_not_tried(monkeypatch):
    model = model_of()
    linear = screened_effects(model, [damage.EFFECT])
    monkeypatch.setattr(stress_history, "MOST_ROUNDS", 1)
    monkeypatch.setattr(stress_history, "CLOSE_MM", 1e-12)
    monkeypatch.setattr(model_selection, "verdict_of", lambda probability, p_value: tuple(probability))
    selection = model_selection.select_model(model, linear, p_value=0.0)
    assert "after 1 rounds" in selection.without["damage"]


def test_a_slid_path_that_does_not_settle_is_a_signature_that_says_why(monkeypatch):
    monkeypatch.setattr(slip, "WHOLE_STEPS", 1)
    monkeypatch.setattr(slip, "HALF_STEPS", 0)
    monkeypatch.setattr(slip, "STILL_MM", -1.0)
    signatures = slip.EFFECT.signatures(model_of())
    assert signatures
    assert all("slid path" in signature.untried and not signature.columns for signature in signatures)


def test_a_loose_pit_whose_gap_does_not_settle_says_so(monkeypatch):
    monkeypatch.setattr(loose_pit, "STILL", 0.0)
    with refused(FemProblem.NOT_CONVERGED, "gap"):
        loose_pit.EFFECT.respond(model_of(), {"gap_mm": 0.1}, loose_pit.at_gap(0.1, pit_turns=True))


PLAIN = Modulus(value=1.1 * E_MPA, sd=0.03 * E_MPA)
"""What another estimate says of E; no part of the answer but where no effect is named."""
SHORT = (viscoelastic, skin, pit_size, sensor_gain, sensor_drift, gripper_compliance, clock_lag)


@pytest.fixture(scope="module")
def explained():
    """Of a catalogue of seven."""

    def louder(pad: Recording) -> Recording:
        return replace(pad, force_N=1.2 * pad.force_N)

    with pytest.MonkeyPatch.context() as patch:
        # flesh here moves by small strain
        patch.setattr(start_to_end, "case_model", partial(start_to_end.case_model, beyond_small_strain=False))
        patch.setattr(start_to_end, "EFFECTS", tuple(module.EFFECT for module in SHORT))
        return start_to_end.explain(injected_case(on_pad("left", louder)), graded=GradedCase(modulus=PLAIN))


def test_a_pads_gain_is_seen_and_named(explained):
    assert explained.detected
    assert explained.p_value < 1e-3
    assert explained.verdict == "sensor_gain"
    assert explained.ranking[0].effect == "sensor_gain"
    assert explained.ranking[0].probability > 0.9
    with_it = [each.probability for each in explained.ranking if "sensor_gain" in each.effect.split("+")]
    assert sum(with_it) > 0.99
    assert sum(hypothesis.probability for hypothesis in explained.ranking) == pytest.approx(1.0)


def test_its_gain_comes_back_with_an_interval(explained):
    parameters = explained.ranking[0].parameters
    said, gain = parameters["pad"].value, parameters["gain"]
    assert (gain.value if said == "left" else 1 / gain.value) == pytest.approx(1.2, rel=0.02)
    low, high = gain.interval
    assert low < (1.2 if said == "left" else 1 / 1.2) < high < 1.1 * low


def test_the_modulus_without_the_gain_is_the_injected_one(explained):
    """Which of the pads it is cannot be told: with the gain on the other one E is 1.2 of what it is."""
    pad = explained.ranking[0].parameters["pad"].value
    true_MPa, other = (E_MPA, 1.2 * E_MPA) if pad == "left" else (1.2 * E_MPA, E_MPA)
    off = (explained.after.value - true_MPa) / (other - true_MPa)
    assert -0.1 < off < 0.55
    assert NINETY * explained.after.sd >= 0.95 * max(
        abs(explained.after.value - E) for E in (true_MPa, other)
    )
    assert explained.before == PLAIN


def test_recordings_that_the_fit_did_not_see_are_predicted_better(explained):
    assert explained.heldout.rms_after < explained.heldout.rms_before
    assert explained.heldout.rms_after < 1.5 * explained.heldout.noise_rms
    assert len(explained.traces) == 2

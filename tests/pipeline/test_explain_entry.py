"""The finder's answer: the JSON of the format, E without an effect, and what goes into batch.toml."""

import json
import re
import tomllib
from dataclasses import replace
from datetime import UTC, datetime
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from fake_explanation import GAIN, candidate, fake_explanation

import pipeline.diagnosis.diagnosis as diagnosis
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.modulus import ModulusEstimate
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory, PadHistory
from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import Candidate, Explanation, HeldOut, Modulus, Parameter, Where
from pipeline.batch.confirmed_effects import effects_on, faults, keyed
from pipeline.batch.settings_file import read_settings
from pipeline.diagnosis.apply_to_settings import confirmed_effects, why_not, with_effects
from pipeline.diagnosis.diagnosis import Diagnosis, graded_case
from pipeline.diagnosis.explaining import effect_entries, explain_entry, parameter_words
from pipeline.fruit.grasped import GraspedFruit
from pipeline.fruit.model_curve import FULL_LOAD, residual_at_full_load
from pipeline.problem import BatchRefused
from reports.effect_words import explain_verdict
from reports.explain_page import explain_html
from tactile.correction import GainFault

BARE = {
    "format": "drupe-mismatch",
    "version": 1,
    "detected": True,
    "p_value": None,
    "where": {"region": "flesh", "centre_mm": [1.0, -2.0, 0.5], "radius_mm": None},
    "when": "all",
    "component": "both",
    "ranking": [
        {
            "effect": "slip",
            "probability": 1,
            "parameters": {
                "pad": {"value": "left", "sd": None, "unit": ""},
                "mu": {"value": 0.25, "sd": 1e-07, "unit": "1", "interval_90": [0.2, 0.3]},
            },
            "log_evidence": 7.0,
            "chi2_gain": 0,
            "heldout_gain": None,
            "heldout_gain_sd": None,
            "refitted": False,
            "E_MPa": None,
        }
    ],
    "verdict": "slip",
    "E_MPa": {"before": {"value": 0.3, "sd": 0.01}, "after": {"value": 0.25, "sd": 0.01}},
    "fit": {"heldout_rms_before": None, "heldout_rms_after": None, "noise_rms": None},
    "next_grasp": None,
    "statistics": {"chi-square": 1e-17},
    "notes": ["Ein Satz über µ."],
    "seconds": {"in all": 3.25},
    "case": "N-01",
    "category": "nectarine",
    "grasps": ["grasp-1"],
    "applied": None,
    "inputs": {"a.h5": "00ff"},
    "versions": {"drupe": "0.1.0"},
    "made_utc": "2026-11-22T09:00:00+00:00",
}


def bare():
    """The least that the finder gives, in numpy's numbers where it may."""
    slip = Candidate(
        effect="slip",
        probability=1,
        parameters={
            "pad": Parameter(value="left", sd=None, unit=""),
            "mu": Parameter(value=np.float64(0.25), sd=1e-7, unit="1", interval=(0.2, np.float64(0.3))),
        },
        log_evidence=np.float64(7.0),
        gain=0,
    )
    return Explanation(
        detected=np.bool_(True),
        p_value=float("nan"),
        statistics={"chi-square": 1e-17},
        where=Where(region="flesh", centre_mm=tuple(np.array([1.0, -2.0, 0.5]))),
        when="all",
        component="both",
        ranking=(slip,),
        verdict="slip",
        before=Modulus(value=0.3, sd=0.01),
        after=Modulus(value=0.25, sd=0.01),
        heldout=None,
        next_grasp=None,
        notes=("Ein Satz über µ.",),
        seconds={"naming": 1.0},
    )


def entry(answer):
    return explain_entry(
        Diagnosis(explanation=answer, grasps=("grasp-1",), facts=(("Pit", "none"),)),
        case="N-01",
        category="nectarine",
        seconds={"in all": 3.25},
        inputs={"a.h5": "00ff"},
        versions={"drupe": "0.1.0"},
        made=datetime(2026, 11, 22, 9, tzinfo=UTC),
    )


def test_the_json_of_an_answer_is_this_to_the_letter():
    """Values and the order of keys."""
    assert json.dumps(entry(bare()).as_json(), allow_nan=False) == json.dumps(BARE)


def test_of_several_names_the_json_has_a_list_and_the_page_always():
    pair = ("slip", "skin+slip")
    assert entry(replace(bare(), verdict=pair)).as_json()["verdict"] == list(pair)
    assert entry(bare()).verdict == ("slip",)


def test_what_is_for_the_page_alone_is_not_in_the_json():
    made = entry(fake_explanation())
    assert set(made.as_json()) == {*BARE}
    assert len(made.cells) == len(fake_explanation().cells)
    np.testing.assert_array_equal(made.maps.visible, fake_explanation().maps.visible)
    np.testing.assert_array_equal(made.traces[1].force_N, fake_explanation().traces[1].force_N)


def test_residuals_on_held_out_grasps_are_there_or_are_not():
    fit = entry(fake_explanation()).as_json()["fit"]
    assert fit == {"heldout_rms_before": 2.61, "heldout_rms_after": 1.04, "noise_rms": 1.0}
    assert set(entry(bare()).as_json()["fit"].values()) == {None}


def test_an_E_that_is_withheld_is_null_and_said_in_words_on_the_page_and_in_the_file():
    nothing = Modulus(value=float("nan"), sd=float("nan"))
    answer = fake_explanation(verdict="unknown", before=nothing, after=nothing, withheld="no law holds")
    withheld = entry(answer)
    written = withheld.as_json()
    assert written["E_withheld"] == "no law holds"
    assert written["E_MPa"]["after"] == {"value": None, "sd": None}
    assert "drupe gives no E: no law holds" in explain_verdict(withheld)
    page = explain_html(replace(withheld, maps=None))
    assert "withheld<small>No law holds" in page
    assert not re.search(r"\bnan\b", page.lower())


def test_both_parts_of_a_pair_bring_their_words_and_verdicts_that_are_no_effect_none():
    entries = effect_entries(["pit_size+sensor_gain", "none", "unknown", "pit_size"])
    assert list(entries) == ["pit_size", "sensor_gain"]
    assert entries["sensor_gain"].advice == SPECS["sensor_gain"].words.advice


def test_parameters_of_further_arms_and_of_pairs_have_words():
    assert parameter_words("viscoelastic", "g_2") == parameter_words("viscoelastic", "g")
    assert parameter_words("pit_size+sensor_gain", "sensor_gain.gain") == "recorded force over true force"
    assert parameter_words("stiffening", "onset_mm") == "travel at first contact"
    assert parameter_words("stiffening", "new_thing") == "new thing"


FRUIT = GraspedFruit(
    shape=None,
    pit=None,
    placed=(),
    failed=(),
    mesh="the mesh",
    poisson_ratio=0.45,
    budget=ErrorBudget(surface_sd_mm=0.2),
)


def case_with(surface_sd_mm):
    return SimpleNamespace(task="the task", mesh_sd_mm=surface_sd_mm)


def inference(*, grasps=(), warnings=()):
    modulus = SimpleNamespace(E_MPa=0.7, E_sd_MPa=0.02, warnings=warnings)
    return SimpleNamespace(modulus=modulus, models=grasps, final_models=grasps, grasps=grasps)


@pytest.mark.parametrize(("stated_mm", "counts_mm"), [(None, 0.2), (0.05, 0.05)])
def test_it_is_what_grading_infers_from_the_surface_that_the_case_states(monkeypatch, stated_mm, counts_mm):
    def inferred(task, fruit, *, solids, workers):
        assert (task, workers) == ("the task", 3)
        assert fruit == replace(FRUIT, budget=ErrorBudget(surface_sd_mm=counts_mm))
        solids["free"] = "factorised"
        return inference()

    monkeypatch.setattr(diagnosis, "fruit_modulus", inferred)
    graded, _ = graded_case(case_with(stated_mm), FRUIT, jobs=3)
    assert graded.modulus == Modulus(value=0.7, sd=0.02)
    assert graded.solids == {"free": "factorised"}


def test_where_no_recording_gives_a_modulus_the_first_ones_reason_is_said(monkeypatch):
    reason = FemFailure(FemProblem.NO_LOAD, "found no frame in which a pad presses")

    def inferred(*_, **__):
        raise ExceptionGroup("no grasp gives a modulus", [reason])

    monkeypatch.setattr(diagnosis, "fruit_modulus", inferred)
    with pytest.raises(FemFailure, match="no frame in which a pad presses"):
        graded_case(case_with(None), FRUIT)


def test_what_grading_warns_of_and_leaves_out_is_handed_on(monkeypatch):
    lost = FemFailure(FemProblem.TOO_FEW_MARKERS, "found 4 markers under load")
    fruit = replace(FRUIT, placed=(SimpleNamespace(name="grasp-1"),))
    contradicting = inference(grasps=(lost,), warnings=("the pads contradict each other",))
    monkeypatch.setattr(diagnosis, "fruit_modulus", lambda *_, **__: contradicting)
    _, notes = graded_case(case_with(None), fruit)
    assert "ignore grasp-1: found 4 markers under load." in notes[0]
    assert "the pads contradict each other" in notes[1]


TEXT = """# a batch of our own
category = "nectarine"   # what else

[grading]  # limits
classes = [
  {name = "ripe", E_max_MPa = 0.4},
  {name = "firm"},
]
"""


def effects_in(text):
    return tomllib.loads(text).get("mismatch", [])


def test_the_old_text_stays_and_the_effect_stands_below_it():
    changed = with_effects(TEXT, confirmed_effects(GAIN, fruit_id="N01"), note="found today")
    assert changed.startswith(TEXT.rstrip())
    (entry,) = effects_in(changed)
    assert entry["effect"] == "sensor_gain"
    assert entry["parameters"] == {"pad": "left", "gain": 1.138}
    assert entry["sd"] == {"gain": 0.0569}
    assert entry["found_in"] == "N01"
    assert "fruits" not in entry


def test_an_effect_that_stands_there_is_left_to_the_user():
    once = with_effects(TEXT, confirmed_effects(GAIN, fruit_id="N01"), note="x")
    better = candidate("sensor_gain", 0.99, pad="left", gain=1.121)
    assert with_effects(once, confirmed_effects(better, fruit_id="N01"), note="x") is None


def test_another_pad_and_another_fruit_have_entries_of_their_own():
    text = with_effects(TEXT, confirmed_effects(GAIN, fruit_id="N01"), note="x")
    right = candidate("sensor_gain", 0.9, pad="right", gain=0.9)
    text = with_effects(text, confirmed_effects(right, fruit_id="N01"), note="x")
    spot = candidate("soft_spot", 0.9, centre_mm=(1.0, 2.0, 3.0), radius_mm=4.0, ratio=0.4)
    for fruit in ("N01", "N02"):
        text = with_effects(text, confirmed_effects(spot, fruit_id=fruit), note="x")
    assert len(effects_in(text)) == 4


def test_a_file_whose_effects_stand_inline_is_left_alone():
    text = TEXT.replace("[grading]", 'mismatch = [{effect = "slip", parameters = {mu = 0.2}}]\n[grading]')
    assert with_effects(text, confirmed_effects(GAIN, fruit_id="N01"), note="x") is None


def test_a_pair_becomes_two_entries():
    pair = candidate(
        "sensor_gain+viscoelastic", 0.9, pad="left", gain=1.1, g=0.3, tau_s=3.0, g_2=0.1, tau_2_s=30.0
    )
    text = with_effects(TEXT, confirmed_effects(pair, fruit_id="N01"), note="x")
    gain, creep = effects_in(text)
    assert gain["parameters"] == {"pad": "left", "gain": 1.1}
    assert set(creep["parameters"]) == {"g", "tau_s", "g_2", "tau_2_s"}


def test_only_one_name_that_helps_unseen_recordings_is_confirmed():
    assert why_not(fake_explanation()) == ""
    assert "nothing is missing" in why_not(fake_explanation(detected=False, verdict="none"))
    assert "the cause is unknown" in why_not(fake_explanation(verdict="unknown"))
    assert "cannot distinguish skin" in why_not(fake_explanation(verdict=("skin", "clock_lag")))
    assert "no second recording" in why_not(fake_explanation(heldout=None))
    worse = HeldOut(rms_before=1.2, rms_after=1.3, noise_rms=1.0)
    assert "does not improve the prediction" in why_not(fake_explanation(heldout=worse))
    quiet = HeldOut(rms_before=0.9, rms_after=0.8, noise_rms=1.0)
    assert "within sensor noise" in why_not(fake_explanation(heldout=quiet))


def test_what_the_recorded_forces_hold_is_not_written_and_the_user_is_told_why():
    adhesion = candidate("adhesion", 0.99, reach_mm=0.13)
    explanation = fake_explanation(verdict="adhesion", ranking=(adhesion,))
    assert why_not(explanation) == (
        "adhesion needs no entry: the recorded forces include it, so E is right without one."
    )
    pair = candidate("adhesion+sensor_gain", 0.9, reach_mm=0.13, pad="left", gain=1.1)
    assert why_not(fake_explanation(verdict="adhesion+sensor_gain", ranking=(pair,))) == ""
    (entry,) = effects_in(with_effects(TEXT, confirmed_effects(pair, fruit_id="N01"), note="x"))
    assert entry["effect"] == "sensor_gain"


def settings(tmp_path, extra):
    path = tmp_path / "batch.toml"
    path.write_text(TEXT + extra)
    return read_settings(path)


def test_settings_give_each_fruit_its_effects_and_the_jaws_faults_to_all(tmp_path):
    text = ""
    spot = candidate("soft_spot", 0.9, centre_mm=(1.0, 2.0, 3.0), radius_mm=4.0, ratio=0.4)
    for winner in (GAIN, spot):
        effects = confirmed_effects(winner, fruit_id="N01")
        text = with_effects(TEXT + text, effects, note="x").removeprefix(TEXT)
    held = settings(tmp_path, text).mismatch
    assert [e.effect for e in effects_on(held, "N01")] == ["sensor_gain", "soft_spot"]
    assert [e.effect for e in effects_on(held, "N02")] == ["sensor_gain"]
    assert faults(held) == (GainFault(pad="left", gain=1.138),)
    assert "found_in" not in keyed(held)[0]


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ('effect = "sensor_gane"\nparameters = {}', 'did you mean "sensor_gain"?'),
        ('effect = "slip"\nparameters = {}', "slip needs the parameter mu"),
        ('effect = "slip"\nparameters = {mu = 0.2, nu = 3}', 'slip has no parameter "nu"'),
        ('effect = "slip"\nparameters = {mu = "x"}', "mu is 'x', expected a number"),
        ('effect = "sensor_gain"\nparameters = {pad = "up", gain = 1}', "expected left, right or tip"),
        ('effect = "sensor_gain"\nparameters = {pad = "left", gain = 0}', "expected 0.01 to 100"),
        ('effect = "pit_offset"\nparameters = {offset_mm = [1, 2]}', "expected 3 numbers"),
        ('effect = "slip"\nparameters = {mu = 0.2}\nsd = {b = 1}', 'sd has the key "b"'),
        ("parameters = {mu = 0.2}", 'the required key "mismatch[1].effect" (line 10) is missing'),
    ],
)
def test_a_faulty_entry_is_said_with_its_key(tmp_path, entry, said):
    with pytest.raises(BatchRefused) as caught:
        settings(tmp_path, f"\n[[mismatch]]\n{entry}\n")
    (line,) = map(str, caught.value.problems)
    assert "batch.toml" in line
    assert '"mismatch[1]' in line
    assert said in line


def test_an_effect_without_all_its_parameters_is_not_applied():
    short = replace(GAIN, parameters={})
    with pytest.raises(ValueError, match="needs the parameter"):
        confirmed_effects(short, fruit_id="N01")


MARKERS = {"left": 4, "right": 3}
FORCE_N = np.array([0.0, 1.0, 5.0, 9.2, 10.0, 9.6, 4.0])
USED = np.array([False, True, True, True, True, True, True])


def pad(name, count):
    frames = len(FORCE_N)
    still = np.zeros((frames, count, 3))
    places = np.arange(3.0 * count).reshape(count, 3)
    return PadHistory(
        name=name, rest_mm=places, surface_mm=places + 50, position_mm=still, gel_displacement_mm=still,
        force_N=still, episode=np.zeros((frames, count), dtype=int), displacement_sd_mm=0.01,
        force_sd_N=0.01, lag1=0.0,
    )  # fmt: skip


def test_the_mean_at_full_load_along_each_pads_way_in_of_the_markers_that_touch():
    history = GraspHistory(
        time_s=np.arange(len(FORCE_N)) / 10.0,
        phase=("load",) * len(FORCE_N),
        pads=tuple(pad(name, count) for name, count in MARKERS.items()),
    )
    axes = np.zeros((2, len(FORCE_N), 3))
    axes[0, :, 0], axes[1, :, 0] = 1.0, -1.0
    full = FORCE_N[USED] >= FULL_LOAD * FORCE_N.max()
    assert full.sum() == 3
    residual = np.full((USED.sum(), 7, 3), 99.0)
    residual[full] = [0.004, 99.0, -99.0]
    residual[np.flatnonzero(full)[0], :, 0] = 0.010
    residual[np.flatnonzero(full)[1], 2] = np.nan
    estimate = Mock(spec=ModulusEstimate, loaded=USED, residual_mm=residual)
    by_pad = residual_at_full_load(estimate, history, axes, np.stack([FORCE_N, FORCE_N]))
    places, values = by_pad["left"]
    np.testing.assert_allclose(places, history.pads[0].surface_mm[[0, 1, 3]])
    assert values == pytest.approx([6.0] * 3)
    places, values = by_pad["right"]
    assert len(places) == 3
    assert values == pytest.approx([-6.0] * 3)

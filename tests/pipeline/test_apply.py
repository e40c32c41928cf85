"""A confirmed effect goes into batch.toml and nothing else of the file changes."""

import tomllib
from dataclasses import replace

import pytest
from fake_explanation import GAIN, candidate, fake_explanation

from fem.mismatch.result import HeldOut
from pipeline.batch.confirmed_effects import effects_on, faults, keyed
from pipeline.batch.settings_file import read_settings
from pipeline.diagnosis.apply_to_settings import confirmed_effects, why_not, with_effects
from pipeline.problem import BatchRefused
from tactile.correction import GainFault

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

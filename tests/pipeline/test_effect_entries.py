"""Words of effects and parameters reach the page from the catalogue."""

from fem.mismatch.catalogue import SPECS
from pipeline.diagnosis.effect_entries import effect_entries, parameter_words


def test_both_parts_of_a_pair_bring_their_words_and_verdicts_that_are_no_effect_none():
    found = effect_entries(["pit_size+sensor_gain", "none", "unknown", "pit_size"])
    assert list(found) == ["pit_size", "sensor_gain"]
    assert found["sensor_gain"].advice == SPECS["sensor_gain"].words.advice


def test_parameters_of_further_arms_and_of_pairs_have_words():
    assert parameter_words("viscoelastic", "g_2") == parameter_words("viscoelastic", "g")
    assert parameter_words("pit_size+sensor_gain", "sensor_gain.gain") == "recorded force over true force"
    assert parameter_words("stiffening", "onset_mm") == "travel at first contact"
    assert parameter_words("stiffening", "new_thing") == "new thing"

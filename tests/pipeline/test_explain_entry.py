"""The finder's answer through the border to reports: the JSON of the format, to the letter."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from fake_explanation import fake_explanation

from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import Candidate, Explanation, Modulus, Parameter, Where
from pipeline.diagnosis.diagnosis import Diagnosis
from pipeline.diagnosis.explaining import effect_entries, explain_entry, parameter_words
from reports.effect_words import explain_verdict
from reports.explain_page import explain_html

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

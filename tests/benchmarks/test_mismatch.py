"""Scores on invented labels: seals, kinds, relatives, costs; other methods; the stored linear problem."""

import hashlib
import json
from dataclasses import replace

import pytest
from baselines import sparse_regression, threshold_of
from cramer_rao import amplitude_bounds
from injected_mismatch import E_MPA, injected_case, on_pad
from mismatch import RELATIVES_FILE, captured, relatives_in, score, scored_label
from reduced_case import gains_of, store, stored
from synthetic_problem import problem

from fem.mismatch import procedure
from fem.mismatch.catalogue import SPECS
from fem.mismatch.effects import clock_lag, pit_size, sensor_gain, skin
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.marker_equations import DESIGN_EFFECT
from fem.mismatch.result import NONE

EFFECTS = {
    "a-1": ("none", {}, "none"),
    "a-2": ("skin", {"Et_N_per_mm": 0.8}, "skin"),
    "a-3": ("skin+slip", {"skin": {"Et_N_per_mm": 0.8}, "slip": {"mu": 0.2}}, ["skin+slip", "skin"]),
    "a-4": ("cavity", {"radius_mm": 4.0}, "soft_spot"),
    "a-5": ("cavity", {"radius_mm": 2.0}, "pose_error"),
}
"""Case: true effect, its parameters, verdict."""


def candidate(name, probability, parameters):
    return {
        "effect": name,
        "probability": probability,
        "refitted": bool(parameters),
        "parameters": {
            key: {"value": 1.1 * x, "sd": 0.05 * x, "interval_90": [0.95 * x, 1.25 * x]}
            for key, x in parameters.items()
        },
    }


@pytest.fixture
def proof(tmp_path):
    """Answers, manifest and labels of five invented cases; E is 0.5 and 0.52 +- 0.02 MPa is the answer."""
    answers, published, seals, runs = tmp_path / "answers", {}, {}, []
    answers.mkdir()
    for number, (case, (effect, parameters, verdict)) in enumerate(EFFECTS.items()):
        label = {
            "case": case,
            "effect": effect,
            "parameters": parameters,
            "E_MPa": 0.5,
            "nu": 0.45,
            "pit_semi_axes_mm": [10.0, 8.0, 12.0],
            "pit_centre_mm": [0.0, 0.1234567890123456, 0.0],
            "category": "plum",
        }
        salt = f"{number:032x}"
        text = salt + json.dumps(label, sort_keys=True, separators=(",", ":"))
        published[case] = {"salt": salt, "label": label}
        seals[case] = hashlib.sha256(text.encode()).hexdigest()
        first = verdict if isinstance(verdict, str) else verdict[0]
        answer = {
            "detected": verdict != "none",
            "verdict": verdict,
            "p_value": 0.4 if verdict == "none" else 1e-3,
            "ranking": [candidate(first, 0.9, parameters if first == "skin" else {})],
            "E_MPa": {"before": {"value": 0.6, "sd": 0.02}, "after": {"value": 0.52, "sd": 0.02}},
            "fit": {"heldout_rms_before": 2.0, "heldout_rms_after": 1.0, "noise_rms": 0.9},
        }
        (answers / f"{case}.json").write_text(json.dumps(answer))
        runs.append({"case": case, "exit_status": 0, "code": "c", "cpu_s": 80.0 + number, "peak_MiB": 2000})
    (answers / "runs.jsonl").write_text("".join(json.dumps(run) + "\n" for run in runs))
    (tmp_path / "manifest.json").write_text(json.dumps(seals))
    (tmp_path / "labels.json").write_text(json.dumps(published))
    return tmp_path


def scored(proof, capsys, csv=None):
    status = score(proof / "answers", proof / "labels.json", proof / "manifest.json", csv)
    return status, capsys.readouterr().out


def test_right_labels_are_scored(proof, capsys):
    status, said = scored(proof, capsys, csv=proof / "cases.csv")
    assert status == 0
    for line in (
        "5 labels, all with the hashes",
        "false alarms in sound cases: 0 of 1",
        "named first, all: 1 of 1",
        "pairs with both named: 1 of 1",
        "unknown or a relative: 1 of 2",
        "taken for another effect: 1 of 2",
        "parameters inside their 90 % intervals: 1 of 1",
        "E in the end, all: inside 90 %: 5 of 5",
        "E without an effect, all: inside 90 %: 0 of 5",
        "names of a verdict: mean 1.20",
        "with over without an effect: median 0.50",
        "a case takes 82 CPU s (median), 84 at most",
    ):
        assert line in said
    assert len((proof / "cases.csv").read_text().splitlines()) == 6


def test_a_changed_label_is_named(proof, capsys):
    labels = json.loads((proof / "labels.json").read_text())
    labels["a-2"]["label"]["E_MPa"] = 0.51
    (proof / "labels.json").write_text(json.dumps(labels))
    status, said = scored(proof, capsys)
    assert status == 1
    assert said.startswith("a-2: the label is not the one that was sealed\n")


def test_a_label_that_is_missing_or_was_never_sealed_is_named(proof, capsys):
    labels = json.loads((proof / "labels.json").read_text())
    labels["b-1"] = labels.pop("a-1")
    (proof / "labels.json").write_text(json.dumps(labels))
    status, said = scored(proof, capsys)
    assert status == 1
    assert said.splitlines()[:3] == ["a-1: no label", "b-1: a label without a seal", "b-1: no answer"]


def test_a_refusal_counts_as_an_answer_with_its_reason(proof, capsys):
    (proof / "answers" / "a-2.json").unlink()
    runs = [json.loads(line) for line in (proof / "answers" / "runs.jsonl").read_text().splitlines()]
    runs[1] |= {"exit_status": 3, "said": "drupe: a-2: no contact"}
    (proof / "answers" / "runs.jsonl").write_text("".join(json.dumps(run) + "\n" for run in runs))
    status, said = scored(proof, capsys)
    assert status == 0
    assert "4 answers, 1 cases without one" in said
    assert "a-2: drupe: a-2: no contact" in said


def test_answers_of_two_states_of_the_code_are_refused(proof, capsys):
    runs = [json.loads(line) for line in (proof / "answers" / "runs.jsonl").read_text().splitlines()]
    runs[1]["code"] = "d"
    (proof / "answers" / "runs.jsonl").write_text("".join(json.dumps(run) + "\n" for run in runs))
    status, said = scored(proof, capsys)
    assert status == 1
    assert "several states of the code: c, d" in said


def test_the_committed_relatives_are_effects_of_the_catalogue():
    """Of that at the time: the split pit has left it since."""
    relatives = relatives_in(RELATIVES_FILE)
    assert len(relatives) > 60
    assert {name for names in relatives.values() for name in names} <= {*SPECS, "split_pit"}


def test_amplitudes_of_a_pair_are_those_of_its_effects():
    label = {
        "effect": "skin+pit_size",
        "parameters": {"skin": {"Et_N_per_mm": 0.8}, "pit_size": {"scale": 1.1}},
    }
    (truth,) = scored_label(label, {})["attempts"]
    assert truth["effect"] == "pit_size+skin"
    assert truth["amplitudes"] == pytest.approx({"skin": 0.8, "pit_size": 0.1})


def test_sparse_regression_names_a_plain_effect_and_has_the_wanted_false_alarms():
    without = [problem({}, seed=seed).linear() for seed in range(12)]
    threshold = threshold_of(without, false_alarms=0.0)
    assert all(
        sparse_regression(null_round, (0.5, 0.01), threshold=threshold)["verdict"] == [NONE]
        for null_round in without
    )
    seen = sparse_regression(problem({"clock_lag": 1.0}, seed=40).linear(), (0.5, 0.01), threshold=threshold)
    assert seen["order"][0] == "clock_lag"


@pytest.fixture(scope="module")
def linear_problem():
    """Of a pad whose force is a fifth too large, by a catalogue of four; and the equations it has."""
    case = injected_case(on_pad("left", lambda pad: replace(pad, force_N=1.2 * pad.force_N)))
    model, _ = procedure.case_model(case)
    recorded = [GraspEquations.of(model, recording) for recording in model.grasps]
    effects = tuple(module.EFFECT for module in (skin, pit_size, sensor_gain, clock_lag))
    with captured() as kept:
        procedure.screened(model, recorded, effects)
    return kept


@pytest.mark.slow
def test_the_linear_round_replays_from_the_file_to_the_same_gains(linear_problem, tmp_path):
    store(tmp_path / "x.npz", linear_problem.case)
    replayed = gains_of(stored(tmp_path / "x.npz").linear())
    assert replayed == pytest.approx(linear_problem.case.facts["gains"], abs=1e-6)
    assert max(replayed, key=replayed.__getitem__) == "sensor_gain"


@pytest.mark.slow
def test_a_bound_counts_every_sample_of_the_markers_and_the_balance_once(linear_problem):
    """Not so many of the markers' as one, as in the linear round, nor the balance as often as they."""
    case = linear_problem.case
    exact, thin, thick = (
        amplitude_bounds(information, case, E_MPa=E_MPA)
        for information in (
            linear_problem.information,
            case.information(),
            DESIGN_EFFECT * case.information(),
        )
    )
    assert all(thick[name] < exact[name] < thin[name] for name in exact)
    assert exact["sensor_gain"] > 2 * thick["sensor_gain"]

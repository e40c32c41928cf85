"""Scores on invented labels and stored rounds: seals, kinds, costs, intervals and bounds in closed form."""

import csv
import hashlib
import json
import re
from collections import Counter
from dataclasses import replace

import mismatch_scores
import numpy as np
import pytest
from baselines import sparse_regression, threshold_of
from clustered_share import clustered_interval
from cramer_rao import amplitude_bounds, amplitude_of
from ideal_confusion import drawn_amounts, ideal_names
from injected_mismatch import E_MPA, injected_case, on_pad
from mismatch import RELATIVES_FILE, captured, relatives_in, score, scored_label
from mismatch_scores import RELIABILITY_BINS, false_alarms, log_score, main, single_lines
from psychometric import fitted_curve
from reduced_case import gains_of, store, stored
from scored_round import full_bounds, scored_round
from sealed_report import reliability_bins
from synthetic_problem import problem

from fem.mismatch import procedure
from fem.mismatch.catalogue import SPECS
from fem.mismatch.effects import clock_lag, pit_size, sensor_gain, skin
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.marker_equations import DESIGN_EFFECT
from fem.mismatch.result import NONE
from fem.mismatch.selection.decision import MISFIT
from samples.mismatch.bank import added_effects
from samples.mismatch.injected import AMPLITUDES

E_MPa = 0.5
PARAMETERS = {
    "skin": lambda amount: {"Et_N_per_mm": amount * E_MPa},
    "graded_modulus": lambda amount: {"gamma": amount},
    "clock_lag": lambda amount: {"lag_s": amount},
    "gripper_compliance": lambda amount: {"mm_per_N": amount},
}
"""Of the label of an effect of so large an amount."""


def labelled_round(amounts, *, fruit="null-200", bounds=None, seed=5):
    """A problem that holds these amounts; its noise leaves the misfit of recordings without mismatch."""
    case = problem(amounts, seed=seed)
    parameters = {name: PARAMETERS[name](amount) for name, amount in amounts.items()}
    answer = {
        "effect": "+".join(sorted(amounts)) or "none",
        "parameters": next(iter(parameters.values())) if len(parameters) == 1 else parameters,
        "E_MPa": E_MPa,
        "drawn_from": {"fruit": fruit, "added": [], "level": 3},
    }
    facts = {"answer": answer, "E_MPa": E_MPa, "bounds": bounds or {}}
    return replace(case, count=round(case.count / MISFIT), facts=case.facts | facts)


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


HALF_CHI_SQUARE = 1.920729
"""Half the 95 % quantile of chi-square with one degree of freedom (tables)."""
NOISE_BOUND = {"skin": 0.0125, "graded_modulus": 0.025, "clock_lag": 0.025, "gripper_compliance": 0.025}
"""1 / sqrt(1600 numbers of variance one) for an amount; a skin's amplitude is E times that."""


def test_without_alarms_the_interval_is_that_of_the_binomial_likelihood():
    """n ln(1 - m) = -chi2 / 2."""
    low, high = clustered_interval([f"fruit {k}" for k in range(40)], [False] * 40)
    assert low == 0
    assert high == pytest.approx(1 - np.exp(-HALF_CHI_SQUARE / 40), abs=5e-4)


def test_clusters_that_are_all_or_nothing_count_once():
    fruit = [str(k) for k in range(20)]
    alarms = [k < 3 for k in range(20)]
    single = clustered_interval(fruit, alarms)
    assert clustered_interval(fruit * 3, alarms * 3) == pytest.approx(single, abs=1e-3)


def test_false_alarms_are_counted_by_fruit():
    p = [("null-1", 0.01), ("null-1", 0.02), ("null-2", 0.5), ("null-3", 0.9)]
    first, uniform, *by_fruit = false_alarms("p", p)
    assert "2 of 4 = 50.0%" in first
    assert "3 fruit" in first
    assert "uniform" in uniform
    assert by_fruit[0].split() == ["null-1:", "0.010", "0.020"]


def test_the_full_bound_of_a_column_adds_the_model_error():
    """Information I becomes I / (1 + I s^2): the variance 1 / I becomes 1 / I + s^2."""
    case = labelled_round({})
    share = 0.02
    plain = amplitude_bounds(case.information(), case, E_MPa=E_MPa)
    full = full_bounds(case.with_model_error({"graded_modulus": share}))
    prior_sd = 3.0
    assert full["graded_modulus"] ** 2 == pytest.approx(
        plain["graded_modulus"] ** 2 + (share * prior_sd) ** 2, rel=1e-6
    )


@pytest.mark.parametrize("effect", ["pit_size", "poisson_ratio", "clock_lag", "gel_creep", "pose_error"])
def test_the_amplitude_of_a_drawn_effect_is_found_from_its_label(effect):
    """Amplitudes of a wide draw lie in the effect's range, and the same case has the same one."""
    without = {"poisson_ratio": 0.45} if effect == "poisson_ratio" else {}
    low, high = AMPLITUDES[effect]
    sizes = []
    for number in range(5):
        (drawn,), _ = added_effects(f"{effect}-3-{number}-1", (effect,))
        (again,), _ = added_effects(f"{effect}-3-{number}-1", (effect,))
        assert drawn == again
        sizes.append(amplitude_of(effect, drawn.parameters, **without))
    assert all(low <= size <= high for size in sizes)
    assert len(set(sizes)) == 5


def test_what_is_in_a_problem_is_detected_and_named():
    scored = scored_round("skin-3-200-1", labelled_round({"skin": 0.8}, bounds=NOISE_BOUND))
    assert scored.scored.detected
    assert scored.scored.named_first
    assert scored.scored.covered
    assert scored.scored.amplitudes == {"skin": pytest.approx(0.8 * E_MPa)}
    assert scored.over_bound(0) == pytest.approx(0.8 * E_MPa / NOISE_BOUND["skin"])
    assert scored.over_bound(1) < scored.over_bound(0)
    assert scored.scored.row["E_after"]["value"] == pytest.approx(E_MPa, rel=0.05)


def test_nothing_is_detected_where_nothing_is():
    scored = scored_round("null-200-1", labelled_round({}))
    assert not scored.scored.detected
    assert scored.scored.verdict == ("none",)
    assert np.exp(log_score(scored)) > 0.8


def test_a_wrong_label_is_counted_as_a_miss():
    case = labelled_round({"skin": 0.8})
    facts = {**case.facts, "answer": {**case.facts["answer"], "effect": "clock_lag", "parameters": {}}}
    scored = scored_round("x-1", replace(case, facts=facts))
    assert scored.scored.detected
    assert not scored.scored.named_first
    assert log_score(scored) < np.log(0.1)
    assert "single effects: named first: 0 of 1" in " ".join(single_lines([scored]))
    ((_, _, count, total),) = reliability_bins([scored.scored], RELIABILITY_BINS).values()
    assert (count, total) == (0, 1)


def test_drawn_amounts_lie_their_number_of_bounds_from_zero():
    linear = labelled_round({}).linear()
    truths, amounts = drawn_amounts(linear, multiples=(2, 8), count=3, rng=np.random.default_rng(0))
    squares = np.einsum("di,ij,dj->d", amounts, linear.equations.normal, amounts)
    assert np.sqrt(squares) == pytest.approx([multiple for _, multiple in truths])
    assert Counter(truths) == {(name, k): 3 for name in linear.equations.ways for k in (2, 8)}


def test_ideal_effects_are_named_far_above_their_bound_and_hardly_below_it():
    rounds = [labelled_round({}, seed=seed).linear() for seed in range(3)]
    named = ideal_names(rounds, multiples=(1, 20), draws=60, rng=np.random.default_rng(0))
    for effect in rounds[0].equations.ways:
        assert named[effect, 20][effect] == 60
        assert named[effect, 1]["none"] > 40


def rounds_folder(folder):
    """Ten cases without mismatch of five fruit, and skins from weak to strong."""
    for number in range(5):
        for record in (1, 2):
            case = labelled_round({}, fruit=f"null-{number}", seed=10 * number + record)
            store(folder / f"null-{number}-{record}.npz", case)
    for number, amount in enumerate((0.02, 0.1, 0.3, 0.6, 1.0)):
        case = labelled_round({"skin": amount}, fruit=f"skin-3-{number}", bounds=NOISE_BOUND, seed=number)
        store(folder / f"skin-3-{number}-1.npz", case)
    return folder


def test_the_script_prints_tables_and_writes_a_figure_and_a_table(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(mismatch_scores, "DRAWS", 5)
    folder = rounds_folder(tmp_path)
    out, table = tmp_path / "scores.png", tmp_path / "scores.csv"
    main(folder, figure=out, csv=table)
    text = capsys.readouterr().out
    assert re.search(r"without mismatch: p < 0\.05 in \d of 10", text)
    assert "single effects: detected: " in text
    assert out.read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 15
    skins = [row for row in rows if row["truth"] == "skin"]
    assert [float(row["amplitude"]) for row in skins] == pytest.approx([0.01, 0.05, 0.15, 0.3, 0.5])
    stimuli = [float(row["over_noise_bound"]) for row in skins]
    curve = fitted_curve(stimuli, [row["detected"] == "True" for row in skins])
    bounds = text[text.index("amplitude over bound of half") :]
    (half,) = re.findall(r"^  skin +5 +(\S+)", bounds, re.MULTILINE)
    assert float(half.strip("()")) == pytest.approx(curve.half, rel=0.01)


def test_the_model_error_is_that_of_all_fruit_without_mismatch(monkeypatch, tmp_path):
    (tmp_path / "evidence").mkdir()
    monkeypatch.setattr(mismatch_scores, "EVIDENCE", tmp_path / "evidence")
    main(rounds_folder(tmp_path), write_model_error=True)
    text = (tmp_path / "evidence" / "model_error.csv").read_text(encoding="utf-8")
    assert "10 cases of 5 fruit" in text
    assert "effect,share" in text


def test_no_fruit_is_scored_with_its_own_model_error(tmp_path):
    """A case whose own data are changed keeps its model error, and another fold's changes."""
    cases = mismatch_scores.loaded(rounds_folder(tmp_path))
    before = mismatch_scores.errors_of_other_fruit(cases)
    cases["null-0-1"] = labelled_round({"graded_modulus": 0.3}, fruit="null-0", seed=1)
    cases["null-0-1"].facts["answer"]["effect"] = "none"
    after = mismatch_scores.errors_of_other_fruit(cases)
    same = {fruit for fruit in before if before[fruit].shares == pytest.approx(after[fruit].shares)}
    fruits = sorted(before)
    fold = fruits.index("null-0") % mismatch_scores.FOLDS
    assert same == set(fruits[fold :: mismatch_scores.FOLDS])


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(SystemExit, match="no stored round"):
        main(tmp_path)

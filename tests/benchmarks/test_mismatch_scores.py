"""Scores of stored rounds: intervals and bounds against closed forms, tables of synthetic problems."""

import csv
import re
from collections import Counter
from dataclasses import replace

import mismatch_scores
import numpy as np
import pytest
from clustered_share import clustered_interval
from cramer_rao import amplitude_bounds, amplitude_of
from ideal_confusion import drawn_amounts, ideal_names
from labelled_round import E_MPa, labelled_round
from mismatch_scores import RELIABILITY_BINS, false_alarms, log_score, main, single_lines
from psychometric import fitted_curve
from reduced_case import store
from scored_round import full_bounds, scored_round
from sealed_report import reliability_bins

from samples.mismatch.bank import added_effects
from samples.mismatch.injected import AMPLITUDES

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
    lines = single_lines([scored])
    assert "single effects: named first: 0 of 1" in " ".join(lines)
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
    assert same == {fruit for fruit in before if int(fruit.rsplit("-", 1)[1]) % mismatch_scores.FOLDS == 0}


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(SystemExit, match="no stored round"):
        main(tmp_path)

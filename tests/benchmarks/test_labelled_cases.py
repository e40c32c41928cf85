"""Cases to work on: the revealed proof's own, or sound fruit of any words."""

import json

import pytest
from sealed_truths import put_on_path

put_on_path()
import labelled_cases  # noqa: E402
from sealed_draw import truth_of  # noqa: E402
from sealed_proof import PROOF  # noqa: E402

from samples.sample_failure import NotInEquilibrium  # noqa: E402


def test_a_revealed_case_holds_what_its_label_says():
    (case,) = labelled_cases.revealed_cases([105])
    label = json.loads((PROOF / "labels.json").read_text())["case-105"]["attempts"][0]
    truth = truth_of(case, 0)
    assert truth["effect"] == label["effect"] == "adhesion+pit_size"
    assert truth["E_MPa"] == pytest.approx(label["E_MPa"], rel=1e-6)
    assert truth["amplitudes"] == pytest.approx(label["amplitudes"], rel=1e-6)


def test_a_number_that_the_proof_does_not_have_is_said():
    with pytest.raises(SystemExit, match="case-999: there is no such case; the proof has 200"):
        labelled_cases.revealed_cases([7, 999])


def test_what_chooses_among_sound_cases_is_no_way_to_choose_revealed_ones(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "sys.argv", ["labelled_cases.py", str(tmp_path / "new"), "--revealed", "7", "--count", "3"]
    )
    with pytest.raises(SystemExit):
        labelled_cases.main()
    assert "leave them out with --revealed" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_cases_that_are_there_are_left_alone_and_one_without_balance_costs_no_other(tmp_path, monkeypatch):
    def simulated(case, folder):
        if case.case_id == cases[1].case_id:
            raise NotInEquilibrium(f"{case.case_id} found no balance")
        made.append(case.case_id)
        return 0, (12.0, 13.0)

    made: list[str] = []
    cases = labelled_cases.sound_cases("any words", "linear")[:3]
    monkeypatch.setattr(labelled_cases, "simulated", simulated)
    labelled_cases.write_cases(tmp_path / "new", cases[:2])
    labelled_cases.write_cases(tmp_path / "new", cases)
    assert made == [cases[0].case_id, cases[2].case_id]
    answers = json.loads((tmp_path / "new" / "answers.json").read_text())
    assert {one["law"] for one in answers.values()} == {"linear"}
    assert list(answers) == made

"""The command: what it writes, refuses and goes on with, on a proof of three cases with made-up answers."""

import json
import subprocess
import sys

import pytest
from sealed_truths import put_on_path, row

put_on_path()
import sealed_proof  # noqa: E402
from sealed_draw import drawn_cases, label_of  # noqa: E402

SALT = "7c" * 32
FEW = {"sound": 2, "single": 1}


@pytest.fixture
def proof(tmp_path, monkeypatch):
    """A repository with a manifest; the salt beside it."""
    monkeypatch.setattr(sealed_proof, "drawn_cases", lambda salt: drawn_cases(salt, FEW))
    (tmp_path / "salt").write_text(SALT + "\n")
    git(tmp_path, "init", "-q")
    (tmp_path / "proof").mkdir()
    run(monkeypatch, tmp_path, "draw", "--salt", str(tmp_path / "salt"))
    commit(tmp_path)
    return tmp_path


def git(folder, *command):
    own = ("-c", "user.name=x", "-c", "user.email=x@y", "-c", "commit.gpgsign=false")
    subprocess.run(["git", "-C", str(folder), *own, *command], check=True, capture_output=True)


def commit(folder):
    git(folder, "add", "proof")
    git(folder, "commit", "-q", "-m", "x")


def run(monkeypatch, folder, *command):
    """The command's exit status."""
    monkeypatch.setattr(sys, "argv", ["sealed_proof.py", *command, "--proof", str(folder / "proof")])
    try:
        sealed_proof.main()
    except SystemExit as end:
        return end.code
    return 0


def answer(folder, **changed):
    """Says "none" of every case."""
    rows = [row(one.case_id, ["none"]) | changed for one in drawn_cases(SALT, FEW)]
    with (folder / "proof" / "answers.jsonl").open("a") as file:
        file.writelines(json.dumps(one) + "\n" for one in rows)


def revealed(folder, monkeypatch):
    answer(folder)
    commit(folder)
    assert run(monkeypatch, folder, "reveal", "--salt", str(folder / "salt")) == 0
    commit(folder)


def test_a_proof_in_order_is_verified_and_scored(proof, monkeypatch, capsys):
    revealed(proof, monkeypatch)
    assert run(monkeypatch, proof, "check") == 0
    said = capsys.readouterr().out
    assert "3 of 3 labels are as sealed" in said
    assert "false alarms in sound cases: 0 of 2" in said
    assert "single effects detected: 0 of 1" in said


def test_a_label_that_was_changed_is_found(proof, monkeypatch, capsys):
    revealed(proof, monkeypatch)
    path = proof / "proof" / "labels.json"
    labels = json.loads(path.read_text())
    sound = next(name for name, one in labels.items() if one["kind"] == "sound")
    labels[sound]["attempts"][0]["E_MPa"] *= 1.001
    path.write_text(json.dumps(labels))
    assert run(monkeypatch, proof, "check") == 1
    assert f"{sound}: the label is not the one that was sealed" in capsys.readouterr().out


def test_an_answer_that_is_changed_after_the_reveal_is_found(proof, monkeypatch, capsys):
    revealed(proof, monkeypatch)
    path = proof / "proof" / "answers.jsonl"
    path.write_text(path.read_text().replace('"none"]', '"skin"]'))
    commit(proof)
    assert run(monkeypatch, proof, "check") == 1
    assert "do not come before salt and labels" in capsys.readouterr().out


def test_an_answer_that_is_changed_and_not_committed_is_found(proof, monkeypatch, capsys):
    revealed(proof, monkeypatch)
    path = proof / "proof" / "answers.jsonl"
    path.write_text(path.read_text().replace('"none"]', '"skin"]'))
    assert run(monkeypatch, proof, "check") == 1
    assert "answers.jsonl differs from what was committed" in capsys.readouterr().out


def test_a_manifest_is_written_once(proof, monkeypatch):
    assert "written once" in run(monkeypatch, proof, "draw", "--salt", str(proof / "salt"))


def test_another_salt_answers_nothing(proof, monkeypatch):
    (proof / "other").write_text("8d" * 32)
    assert "drawn otherwise than sealed" in run(monkeypatch, proof, "answer", "--salt", str(proof / "other"))


def test_cases_with_an_answer_are_left_alone_and_the_rest_are_answered(proof, monkeypatch):
    done, *left = drawn_cases(SALT, FEW)
    with (proof / "proof" / "answers.jsonl").open("w") as file:
        file.write(json.dumps(row(done.case_id, ["skin"])) + '\n{"case": "ca')
    seen = []

    def simulated(case, folder):
        folder.mkdir(parents=True)
        (folder / "case.toml").write_text("")
        seen.append(case.case_id)
        return 0, (5.0, 4.0)

    def explained(folder, work, **_):
        assert {path.name for path in folder.iterdir()} == {"case.toml"}
        answered = row("", ["none"])
        del answered["case"], answered["attempt"], answered["peaks_N"]
        return answered, None

    monkeypatch.setattr(sealed_proof, "simulated", simulated)
    monkeypatch.setattr(sealed_proof, "explained", explained)
    cases = proof / "cases"
    assert run(monkeypatch, proof, "answer", "--salt", str(proof / "salt"), "--cases", str(cases)) == 0
    assert seen == [one.case_id for one in left]
    rows = sealed_proof.rows_in(proof / "proof" / "answers.jsonl")
    assert [one["verdict"] for one in rows] == [["skin"], ["none"], ["none"]]
    assert rows[1]["peaks_N"] == [5.0, 4.0]
    assert list(cases.iterdir()) == []


def test_figures_so_far_say_that_they_prove_nothing(proof, monkeypatch, capsys):
    answer(proof)
    salt = ("--salt", str(proof / "salt"))
    assert run(monkeypatch, proof, "check", "--unrevealed", *salt) == 0
    assert "prove nothing yet" in capsys.readouterr().out


def test_labels_of_the_draw_are_those_that_are_revealed(proof, monkeypatch):
    revealed(proof, monkeypatch)
    labels = json.loads((proof / "proof" / "labels.json").read_text())
    for one in drawn_cases(SALT, FEW):
        assert labels[one.case_id]["attempts"][0]["effect"] == label_of(one)["attempts"][0]["effect"]

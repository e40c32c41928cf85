"""The check of a blind test on a repository of three made-up cases: what it verifies, scores and refuses."""

import json
import subprocess

import pytest
import sealed_proof
from sealed_truths import label, row
from sealing import sealed

SALT = "7c" * 32
LABELS = {
    "case-1": label("sound", "none"),
    "case-2": label("single", "skin", Et_N_per_mm=1.0),
    "case-3": label("sound", "none", E=0.6),
}


@pytest.fixture
def proof(tmp_path):
    """A repository with manifest, answers of "none", salt and labels, committed in this order."""
    folder = tmp_path / "proof"
    folder.mkdir()
    git(tmp_path, "init", "-q")
    seals = {case: sealed(SALT, case_label) for case, case_label in LABELS.items()}
    (folder / "manifest.json").write_text(json.dumps({"seals": seals}))
    commit(tmp_path)
    answers = "".join(json.dumps(row(case, ["none"])) + "\n" for case in LABELS)
    (folder / "answers.jsonl").write_text(answers + '{"case": "ca')
    commit(tmp_path)
    (folder / "salt.txt").write_text(SALT + "\n")
    (folder / "labels.json").write_text(json.dumps(LABELS))
    commit(tmp_path)
    return tmp_path


def git(folder, *command):
    identity = ("-c", "user.name=x", "-c", "user.email=x@y", "-c", "commit.gpgsign=false")
    subprocess.run(["git", "-C", str(folder), *identity, *command], check=True, capture_output=True)


def commit(folder):
    git(folder, "add", "proof")
    git(folder, "commit", "-q", "-m", "x")


def test_a_proof_in_order_is_verified_and_scored(proof, capsys):
    assert sealed_proof.main(proof / "proof") == 0
    said = capsys.readouterr().out
    assert "3 of 3 labels are as sealed" in said
    assert "false alarms in sound cases: 0 of 2" in said
    assert "single effects detected: 0 of 1" in said


def test_a_label_that_was_changed_is_found(proof, capsys):
    path = proof / "proof" / "labels.json"
    labels = json.loads(path.read_text())
    labels["case-3"]["attempts"][0]["E_MPa"] *= 1.001
    path.write_text(json.dumps(labels))
    assert sealed_proof.main(proof / "proof") == 1
    assert "case-3: the label is not the one that was sealed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("is_committed", "said"),
    [
        (True, "do not come before salt and labels"),
        (False, "answers.jsonl differs from what was committed"),
    ],
)
def test_an_answer_that_is_changed_after_the_reveal_is_found(proof, capsys, is_committed, said):
    path = proof / "proof" / "answers.jsonl"
    path.write_text(path.read_text().replace('"none"]', '"skin"]'))
    if is_committed:
        commit(proof)
    assert sealed_proof.main(proof / "proof") == 1
    assert said in capsys.readouterr().out

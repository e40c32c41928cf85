"""The seal holds what it says: a changed label, salt, or answer after the reveal is found."""

import hashlib
import subprocess

import pytest
from sealed_truths import label
from sealing import broken_seals, canonical, order_of_commits, read_salt, sealed

SALT = "3f" * 32
LABELS = {"case-001": label("single", "skin", Et_N_per_mm=1.25), "case-002": label("sound", "none")}


def seals():
    return {name: sealed(SALT, case_label) for name, case_label in LABELS.items()}


def test_a_seal_is_sha_256_of_salt_and_canonical_text():
    text = '{"a":[1,2.5],"b":"x"}'
    assert canonical({"b": "x", "a": (1, 2.5)}) == text
    assert sealed(SALT, {"b": "x", "a": [1, 2.5]}) == hashlib.sha256((SALT + text).encode()).hexdigest()


def texts(labels, salt):
    return {case: salt + canonical(label) for case, label in labels.items()}


@pytest.mark.parametrize(
    ("labels", "salt", "said"),
    [
        ({**LABELS, "case-002": label("single", "slip", mu=0.1)}, SALT, "case-002: the label is not"),
        ({"case-001": LABELS["case-001"]}, SALT, "case-002: no label"),
        ({**LABELS, "case-003": label("sound", "none")}, SALT, "case-003: a label without a seal"),
        (LABELS, "4f" * 32, "case-001: the label is not"),
    ],
)
def test_whatever_was_changed_is_named(labels, salt, said):
    assert broken_seals(seals(), texts(labels, salt))[0].startswith(said)


def test_a_salt_that_can_be_guessed_is_refused(tmp_path):
    (tmp_path / "salt.txt").write_text("hello\n")
    with pytest.raises(ValueError, match="holds 5 characters"):
        read_salt(tmp_path / "salt.txt")


def committed(folder, *steps):
    """A repository in which each step writes and commits files."""

    def git(*command):
        identity = ("-c", "user.name=x", "-c", "user.email=x@y", "-c", "commit.gpgsign=false")
        subprocess.run(["git", "-C", str(folder), *identity, *command], check=True, capture_output=True)

    git("init", "-q")
    for k, files in enumerate(steps):
        for name in files:
            path = folder / name
            path.write_text(path.read_text() + "more\n" if path.exists() else "first\n")
        git("add", ".")
        git("commit", "-q", "-m", str(k))
    return folder


def test_history_in_order_is_verified(tmp_path):
    steps = (("manifest.json",), ("answers.jsonl",), ("answers.jsonl",), ("salt.txt", "labels.json"))
    assert order_of_commits(committed(tmp_path, *steps))[0] is True


@pytest.mark.parametrize(
    "steps",
    [
        (("manifest.json", "answers.jsonl"), ("salt.txt", "labels.json")),
        (("manifest.json",), ("salt.txt", "labels.json"), ("answers.jsonl",)),
        (("manifest.json",), ("answers.jsonl",), ("salt.txt", "labels.json"), ("answers.jsonl",)),
        (("manifest.json",), ("answers.jsonl",), ("manifest.json",), ("salt.txt", "labels.json")),
        (("manifest.json",), ("answers.jsonl", "salt.txt", "labels.json")),
    ],
    ids=[
        "with the manifest",
        "after the salt",
        "changed after the salt",
        "manifest changed",
        "with the salt",
    ],
)
def test_history_out_of_order_is_found(tmp_path, steps):
    assert order_of_commits(committed(tmp_path, *steps))[0] is False


def test_without_a_repository_the_order_cannot_be_verified(tmp_path):
    ordered, said = order_of_commits(tmp_path)
    assert ordered is None
    assert "could not be verified" in said[0]

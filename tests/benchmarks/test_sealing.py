"""The sealed proof: what its seal holds, what its check verifies and refuses, scores known by hand."""

import hashlib
import json
import subprocess

import numpy as np
import pytest
import sealed_proof
from psychometric import fitted_curve
from sealed_report import report
from sealed_scores import interval, parameter_rows, scored
from sealed_truths import label, row
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


PROOF_SALT = "7c" * 32
PROOF_LABELS = {
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
    seals = {case: sealed(PROOF_SALT, case_label) for case, case_label in PROOF_LABELS.items()}
    (folder / "manifest.json").write_text(json.dumps({"seals": seals}))
    commit(tmp_path)
    answers = "".join(json.dumps(row(case, ["none"])) + "\n" for case in PROOF_LABELS)
    (folder / "answers.jsonl").write_text(answers + '{"case": "ca')
    commit(tmp_path)
    (folder / "salt.txt").write_text(PROOF_SALT + "\n")
    (folder / "labels.json").write_text(json.dumps(PROOF_LABELS))
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
    [(True, "do not come before salt and labels"), (False, "answers.jsonl differs from what was committed")],
)
def test_an_answer_that_is_changed_after_the_reveal_is_found(proof, capsys, is_committed, said):
    path = proof / "proof" / "answers.jsonl"
    path.write_text(path.read_text().replace('"none"]', '"skin"]'))
    if is_committed:
        commit(proof)
    assert sealed_proof.main(proof / "proof") == 1
    assert said in capsys.readouterr().out


SKIN = {"Et_N_per_mm": {"value": 1.1, "sd": 0.1, "interval": [0.94, 1.26]}}
CASES = {
    "a": (label("sound", "none"), row("a", ["none"], p=0.6)),
    "b": (label("sound", "none"), row("b", ["slip"], p=0.01, first="slip", probability=0.7)),
    "c": (
        label("single", "skin", Et_N_per_mm=1.0),
        row("c", ["skin"], p=1e-4, first="skin", probability=0.97, parameters=SKIN),
    ),
    "d": (label("single", "slip", mu=0.2), row("d", ["none"], p=0.3, signal=2.0)),
    "e": (
        label("pair", "skin+slip", skin={"Et_N_per_mm": 1.0}, slip={"mu": 0.1}),
        row("e", ["skin+slip", "skin"], p=1e-5, first="skin+slip", E=(0.6, 0.01)),
    ),
    "f": (label("outside", "unknown", physics="palm"), row("f", ["unknown"], p=1e-5, first="slip")),
    "g": (label("outside", "unknown", physics="drainage"), row("g", ["viscoelastic"], first="viscoelastic")),
}
SCORED_LABELS = {name: case_label for name, (case_label, _) in CASES.items()}


def lines(**changed):
    rows = [answer | changed.get(name, {}) for name, (_, answer) in CASES.items()]
    return report(rows, SCORED_LABELS)


def line(start, reported):
    return next(text for text in reported if text.strip().startswith(start))


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ("false alarms", "1 of 2"),
        ("single effects detected", "1 of 2"),
        ("named first, signal/noise over 10", "1 of 1"),
        ("named first, all", "1 of 2"),
        ("pairs with both named", "1 of 1"),
        ("verdict covers the truth", "2 of 2"),
        ("outside the catalogue: called unknown", "1 of 2"),
        ("unknown or a relative", "2 of 2"),
        ("parameters inside", "1 of 1"),
        ("E in the end, all", "6 of 7"),
        ("E in the end, pair", "0 of 1"),
        ("skin+slip ", "1 x [skin+slip | skin]"),
        ("this finder", "1 of 2"),
    ],
)
def test_each_share_is_what_it_is_by_hand(start, said):
    assert said in line(start, lines())


def test_a_case_without_an_answer_is_reported_and_not_scored():
    reported = lines(a={"failure": "ValueError: x"})
    assert line("6 answers, 1 cases without one", reported)
    assert "1 of 1" in line("false alarms", reported)


def test_a_physics_that_the_catalogue_has_learnt_counts_as_a_single_effect():
    case = scored({**CASES["f"][1], "catalogue": ["skin", "third_contact"]}, SCORED_LABELS["f"])
    assert (case.kind, case.truth) == ("single", "third_contact")
    case = scored({**CASES["g"][1], "catalogue": ["skin", "drainage"]}, SCORED_LABELS["g"])
    assert (case.kind, case.truth) == ("single", "drainage")


def test_a_drift_is_scored_in_newtons_of_the_simulated_peak():
    drift = {"newton_per_s": {"value": 0.11, "sd": 0.01, "interval": [0.09, 0.13]}}
    answer = row("x", ["sensor_drift"], first="sensor_drift", parameters=drift)
    ((name, error, inside),) = parameter_rows(
        scored(answer, label("single", "sensor_drift", pad="left", share_per_s=0.01))
    )
    assert name == "sensor_drift.newton_per_s"
    assert error == pytest.approx(0.1)
    assert inside


def test_binomial_intervals_are_those_of_the_tables():
    """Clopper and Pearson 1934: none of 10 within 0 to .3085, 5 of 10 within .1871 to .8129."""
    assert interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert interval(5, 10) == pytest.approx((0.1871, 0.8129), abs=1e-4)


def test_a_curve_finds_the_half_of_the_law_that_drew_its_cases():
    rng = np.random.default_rng(3)
    x = np.exp(rng.uniform(np.log(0.01), np.log(10.0), 600))
    seen = rng.uniform(size=600) < 1 / (1 + (0.3 / x) ** 2.5)
    curve = fitted_curve(x.tolist(), seen.tolist())
    assert curve.half == pytest.approx(0.3, rel=0.2)
    assert curve.steepness == pytest.approx(2.5, rel=0.25)


def test_a_curve_of_cases_all_seen_is_finite_and_marked():
    curve = fitted_curve([1.0, 2.0, 4.0], [True, True, True])
    assert np.isfinite(curve.half)
    assert not curve.bracketed
    assert curve.half < 1.0

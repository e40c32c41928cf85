"""What the terminal says when a run ends: every cause by the fruit that it concerns."""

import io
from datetime import UTC, datetime

import pytest
from rich.console import Console

from pipeline.ranking.run_summary import MOST_CHARACTERS, print_summary
from reports.entries import BatchEntry, FruitEntry

NOON = datetime(2026, 8, 14, 12, tzinfo=UTC)


@pytest.fixture
def lines(tmp_path):
    """The lines that the terminal shows of these fruit."""

    def shown(*fruits):
        batch = BatchEntry(
            name="b", category="nectarine", fruits=fruits, started_utc=NOON, finished_utc=NOON, exit_status=4
        )
        text = io.StringIO()
        print_summary(batch, tmp_path, console=Console(file=text, width=80))
        return text.getvalue().splitlines()

    return shown


def fruit(fruit_id, *doubts, ok=True):
    E = {"E_MPa": 0.5, "E_sd_MPa": 0.05} if ok else {"reason": "no grasp"}
    return FruitEntry(fruit_id=fruit_id, ok=ok, outcome="graded" if ok else "no-grasp", doubts=doubts, **E)


def test_a_fruit_in_doubt_has_a_line_with_its_id_and_the_cause(lines):
    said = lines(fruit("N01"), fruit("N02", "grasp-1: forces look like grams [g].", "pit.ply is turned."))
    assert "E in doubt: N02: grasp-1: forces look like grams [g] (and 1 more)" in said
    assert not any(line.startswith("E in doubt: N01") for line in said)


def test_a_cause_that_fruit_share_is_said_once_with_their_ids(lines):
    shared = "The gripper reads 1.2 of the reference's modulus."
    said = lines(*(fruit(f"{k}", shared) for k in range(1, 9)), fruit("9", "another."))
    doubts = [line for line in said if line.startswith("E in doubt")]
    assert doubts == [
        "E in doubt: 1, 2, 3, 4, 5 and 3 more: The gripper reads 1.2 of the reference's modulus",
        "E in doubt: 9: another",
    ]


def test_a_long_cause_is_cut_between_words_and_one_not_graded_has_its_reason_alone(lines):
    said = lines(fruit("A", "word " * 100), fruit("B", "a doubt", ok=False))
    (line,) = [one for one in said if one.startswith("E in doubt")]
    assert line.endswith("word ...")
    assert len(line) <= MOST_CHARACTERS + len("E in doubt: A:  ...")
    assert "not graded: B: no-grasp: no grasp" in said

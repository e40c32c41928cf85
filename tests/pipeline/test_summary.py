"""What the terminal says when a run ends: every cause by the fruit that it concerns."""

import io
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from rich.console import Console

from pipeline.ranking.run_summary import MOST_LINES, print_summary
from reports.entries import BatchEntry, FruitEntry, ScreenEntry, Suspect, Unfinished

NOON = datetime(2026, 8, 14, 12, tzinfo=UTC)


@pytest.fixture
def lines(tmp_path):
    """The lines that the terminal shows of these fruit."""

    def shown(*fruits, **known):
        batch = BatchEntry(
            **{"name": "b", "category": "nectarine", "exit_status": 4, **known},
            fruits=fruits,
            started_utc=NOON,
            finished_utc=NOON,
        )
        text = io.StringIO()
        print_summary(batch, tmp_path, console=Console(file=text, width=80))
        return text.getvalue().splitlines()

    return shown


def test_of_an_interrupted_run_it_says_how_many_are_done(lines):
    unfinished = Unfinished(done=1, total=3, interrupted=True)
    assert "interrupted: 1 of 3 fruit done" in lines(fruit("N01"), exit_status=None, unfinished=unfinished)


def test_the_ranking_is_in_the_language_of_the_locale(lines, monkeypatch):
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    header, row, *_ = lines(fruit("N01", "no rig."))
    assert header.split() == ["Rang", "Frucht", "E", "(MPa)", "±", "Reife", "Bemerkungen"]
    assert "0,500  0,050" in row
    assert "E ist zweifelhaft" in row


def fruit(fruit_id, *doubts, ok=True):
    E = {"E_MPa": 0.5, "E_sd_MPa": 0.05} if ok else {"reason": "no grasp"}
    return FruitEntry(fruit_id=fruit_id, ok=ok, outcome="graded" if ok else "no-grasp", doubts=doubts, **E)


def test_a_fruit_in_doubt_has_a_line_with_its_id_and_the_cause(lines):
    said = lines(fruit("N01"), fruit("N02", "grasp-1: forces look like grams [g].", "pit.ply is turned."))
    assert "E in doubt: N02: grasp-1: forces look like grams [g]." in said
    assert "E in doubt: N02: pit.ply is turned." in said
    assert not any(line.startswith("E in doubt: N01") for line in said)


def test_a_cause_that_fruit_share_is_said_once_with_their_ids(lines):
    shared = "The gripper reads 1.2 of the reference's modulus."
    said = lines(*(fruit(f"{k}", shared) for k in range(1, 9)), fruit("9", "another."))
    doubts = [line for line in said if line.startswith("E in doubt")]
    assert doubts == [
        "E in doubt: 1, 2, 3, 4, 5 and 3 more: The gripper reads 1.2 of the reference's modulus.",
        "E in doubt: 9: another.",
    ]


BOUND = "E is a lower bound on a softer rig. A gripper of 8 N/mm would give 90 % of that travel itself."


@pytest.mark.parametrize(
    ("warnings", "expected"),
    [
        ([[BOUND], [BOUND], [BOUND]], [f"warning: all fruit: {BOUND}"]),
        ([[BOUND, "Own."], [BOUND], []], [f"warning: 1, 2: {BOUND}", "warning: 1: Own."]),
        ([["First.", BOUND], [BOUND], [BOUND]], [f"warning: all fruit: {BOUND}", "warning: 1: First."]),
        ([[BOUND, BOUND]], [f"warning: 1: {BOUND}"]),
        ([["word " * 100 + "end."]], ["warning: 1: " + "word " * 100 + "end."]),
    ],
)
def test_a_warning_is_said_whole_and_once(lines, warnings, expected):
    fruits = [replace(fruit(str(k)), warnings=tuple(sentences)) for k, sentences in enumerate(warnings, 1)]
    assert [line for line in lines(*fruits) if line.startswith("warning")] == expected


def test_so_many_warnings_are_counted_and_one_not_graded_has_its_reason_alone(lines):
    many = replace(fruit("A"), warnings=tuple(f"{k}." for k in range(MOST_LINES + 3)))
    said = lines(many, fruit("B", "a doubt", ok=False))
    assert len([line for line in said if line.startswith("warning")]) == MOST_LINES + 1
    assert "warning: see report.html for 3 more" in said
    assert "not graded: B: no-grasp: no grasp" in said


SKIN = Suspect(name="skin", short="a stiff skin carries part of the load", advice="")


def test_what_the_screen_suspects_is_one_line_for_all_fruit_that_share_it(lines):
    screen = ScreenEntry(p_value=0.01, suspects=(SKIN,))
    said = lines(
        replace(fruit("N01"), screen=screen),
        replace(fruit("N02"), screen=replace(screen, p_value=0.02)),
        replace(fruit("N03"), screen=ScreenEntry(p_value=0.7)),
        replace(fruit("N04"), screen=ScreenEntry(why_not="one recording alone tells too little")),
    )
    (line,) = [text for text in said if "suspected" in text]
    assert line.endswith("a stiff skin carries part of the load (run drupe explain for details): N01, N02")
    (why,) = [text for text in said if "not tested" in text]
    assert why == "not tested for missing physics: one recording alone tells too little: N04"
    assert not any("N03:" in text for text in said)


def test_a_fault_of_the_whole_batch_is_said(lines):
    said = "The left pad reads 4 % too much force."
    assert f"fault of the whole batch: {said}" in lines(fruit("N01"), faults=(said,))

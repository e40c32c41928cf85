"""Progress and the summary on the terminal."""

import io
import os
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from rich.console import Console
from small_batches import python

from pipeline.ranking.run_summary import MOST_LINES, print_summary
from pipeline.run.progress import BatchProgress, RunConsole
from reports.entries import BatchEntry, FruitEntry, ScreenEntry, Suspect, Unfinished


@pytest.mark.parametrize(("verbose", "lines"), [(True, 1), (False, 0)])
def test_on_a_terminal_stages_and_lines_of_libraries_are_shown_where_that_is_asked_for(verbose, lines):
    console = RunConsole(verbose=verbose)
    console.file = shown = io.StringIO()
    console._force_terminal = True
    with BatchProgress(console, total=1) as progress:
        progress.stage("N01", "mesh: photo 3 of 20")
        progress.noted("N01", "trimesh: failed to load")
        progress.done("N01", "E = 0.5 MPa")
    assert shown.getvalue().count("] N01: mesh") == lines
    assert shown.getvalue().count("N01 (mesh): trimesh: failed to load") == lines
    assert "N01: E = 0.5 MPa (1 of 1)" in shown.getvalue()


def test_quiet_shows_nothing(capsys):
    with BatchProgress(RunConsole(quiet=True), total=1) as progress:
        progress.stage("N01", "mesh")
        progress.done("N01", "E = 0.5 MPa")
    assert capsys.readouterr() == ("", "")


TALKING = """
import logging, os, sys, warnings
from pathlib import Path
import typer
import pipeline.start
from pipeline import cli

def app(**_):
    try:
        raise KeyError("texture")
    except KeyError:
        logging.getLogger("trimesh").exception("failed to load")
    warnings.warn("deprecated")
    os.write(1, b"[Open3D WARNING] no normals\\n")
    os.write(2, b"ERROR: In vtkPolyData.cxx\\n")
    typer.echo("drupe's own result")
    typer.echo("drupe's own sentence", err=True)

cli.app = app
pipeline.start.main()
"""
OF_LIBRARIES = (
    "failed to load", "KeyError: 'texture'", "UserWarning: deprecated",
    "[Open3D WARNING] no normals",
    "ERROR: In vtkPolyData.cxx",
)  # fmt: skip


@pytest.mark.parametrize("shown", [False, True])
def test_the_terminal_shows_what_libraries_say_only_where_that_is_asked_for(shown):
    environment = {**os.environ, **({"DRUPE_DEBUG": "1"} if shown else {})}
    done = python(TALKING, env=environment)
    assert done.returncode == 0
    assert "drupe's own result\n" in done.stdout
    assert "drupe's own sentence\n" in done.stderr
    said = done.stdout + done.stderr
    assert [library in said for library in OF_LIBRARIES] == [shown] * len(OF_LIBRARIES)


class Clock:
    """A clock that a test sets."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s


def ends(before=None, total=4):
    """What is said after fruit that end every 20 s."""
    clock, text = Clock(), io.StringIO()
    with BatchProgress(Console(file=text, width=200), total=total, before=before, clock=clock) as progress:
        for fruit in range(total):
            progress.stage(str(fruit), "mesh")
            clock.now_s += 20
            progress.done(str(fruit), "E = 1")
    return [line.split("E = 1 ")[1] for line in text.getvalue().splitlines() if "E = 1" in line]


def test_a_log_says_the_time_left_from_the_second_fruit_to_the_last_but_one():
    assert ends() == ["(1 of 4)", "(2 of 4, about 00:40 left)", "(3 of 4, about 00:20 left)", "(4 of 4)"]


def test_two_workers_share_the_fruit_that_are_left():
    clock, text = Clock(), io.StringIO()
    with BatchProgress(Console(file=text, width=200), total=6, clock=clock) as progress:
        progress.stage("0", "mesh")
        progress.stage("1", "mesh")
        for fruit in range(4):
            clock.now_s += 99 if fruit % 2 == 0 else 1  # fruit take 100 s, the second worker's 1 s later
            progress.done(str(fruit), "E = 1")
            progress.stage(str(fruit + 2), "mesh")
    notes = [line.split("E = 1 ")[1] for line in text.getvalue().splitlines() if "E = 1" in line]
    assert notes[0] == "(1 of 6)"
    assert notes[1] == "(2 of 6, about 03:18 left)"  # not the second between the first two ends
    assert notes[3] == "(4 of 6, about 01:39 left)"


def test_fruit_of_a_watched_batch_are_counted_among_those_that_have_come():
    assert ends(before=12, total=2) == ["(13 of 14 that have come)", "(14 of 14 that have come)"]


@pytest.mark.parametrize("width", [60, 80, 160])
def test_the_terminal_shows_the_stages_of_fruit_at_work(width):
    shown = io.StringIO()
    console = Console(file=shown, force_terminal=True, width=width, color_system=None)
    progress = BatchProgress(console, total=40, clock=Clock())

    def drawn():
        shown.seek(0)
        shown.truncate()
        progress._bar.refresh()
        return shown.getvalue()

    with progress:
        progress.stage("N01", "photos")
        progress.stage("N02", "contact: grasp-1")
        assert "N01: photos" in drawn()
        assert "N02: contact: grasp-1" in drawn()
        assert "0/40" in drawn()
        progress.done("N01", "E = 0.5 MPa")
        assert "1/40" in drawn()
        for number in range(3, 23):
            progress.stage(f"N{number:02d}", "photos")
        many = drawn()
        assert "N09: photos" in many
        assert "N10: photos" not in many
        assert "and 13 more fruit" in many


NOON = datetime(2026, 8, 14, 12, tzinfo=UTC)


@pytest.fixture
def shown_lines(tmp_path):
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


def test_of_an_interrupted_run_it_says_how_many_are_done(shown_lines):
    unfinished = Unfinished(done=1, total=3, interrupted=True)
    assert "interrupted: 1 of 3 fruit done" in shown_lines(
        fruit("N01"), exit_status=None, unfinished=unfinished
    )


def test_the_ranking_is_in_the_language_of_the_locale(shown_lines, monkeypatch):
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    header, row, *_ = shown_lines(fruit("N01", "no rig."))
    assert header.split() == ["Rang", "Frucht", "E", "(MPa)", "±", "Reife", "Bemerkungen"]
    assert "0,500  0,050" in row
    assert "E ist zweifelhaft" in row


def fruit(fruit_id, *doubts, ok=True):
    E = {"E_MPa": 0.5, "E_sd_MPa": 0.05} if ok else {"reason": "no grasp"}
    return FruitEntry(fruit_id=fruit_id, ok=ok, outcome="graded" if ok else "no-grasp", doubts=doubts, **E)


def test_a_fruit_in_doubt_has_a_line_with_its_id_and_the_cause(shown_lines):
    said = shown_lines(
        fruit("N01"), fruit("N02", "grasp-1: forces look like grams [g].", "pit.ply is turned.")
    )
    assert "E in doubt: N02: grasp-1: forces look like grams [g]." in said
    assert "E in doubt: N02: pit.ply is turned." in said
    assert not any(line.startswith("E in doubt: N01") for line in said)


def test_a_cause_that_fruit_share_is_said_once_with_their_ids(shown_lines):
    shared = "The gripper reads 1.2 of the reference's modulus."
    said = shown_lines(*(fruit(f"{k}", shared) for k in range(1, 9)), fruit("9", "another."))
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
def test_a_warning_is_said_whole_and_once(shown_lines, warnings, expected):
    fruits = [replace(fruit(str(k)), warnings=tuple(sentences)) for k, sentences in enumerate(warnings, 1)]
    assert [line for line in shown_lines(*fruits) if line.startswith("warning")] == expected


def test_so_many_warnings_are_counted_and_one_not_graded_has_its_reason_alone(shown_lines):
    many = replace(fruit("A"), warnings=tuple(f"{k}." for k in range(MOST_LINES + 3)))
    said = shown_lines(many, fruit("B", "a doubt", ok=False))
    assert len([line for line in said if line.startswith("warning")]) == MOST_LINES + 1
    assert "warning: see report.html for 3 more" in said
    assert "not graded: B: no-grasp: no grasp" in said


SKIN = Suspect(name="skin", short="a stiff skin carries part of the load", advice="")


def test_what_the_screen_suspects_is_one_line_for_all_fruit_that_share_it(shown_lines):
    screen = ScreenEntry(p_value=0.01, suspects=(SKIN,))
    said = shown_lines(
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


def test_a_fault_of_the_whole_batch_is_said(shown_lines):
    said = "The left pad reads 4 % too much force."
    assert f"fault of the whole batch: {said}" in shown_lines(fruit("N01"), faults=(said,))

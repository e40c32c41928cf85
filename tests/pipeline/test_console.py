"""What a run says on the terminal, and what a log keeps."""

import io
import subprocess
import sys
from datetime import UTC, datetime

import pytest

from pipeline.problem import BatchRefused
from pipeline.run.console import HEAD, RunConsole
from pipeline.run.progress import BatchProgress


def noon():
    return datetime(2026, 8, 14, 12, tzinfo=UTC)


def test_every_line_is_in_the_log_with_its_time_and_quiet_shows_none(tmp_path, capsys):
    log = tmp_path / "run.log"
    console = RunConsole(quiet=True, log=log, now=noon)
    with BatchProgress(console, total=1) as progress:
        progress.stage("N01", "mesh")
        progress.done("N01", "E = 0.5 MPa")
    assert capsys.readouterr() == ("", "")
    first, begins, stage, done = log.read_text().splitlines()
    assert first == HEAD
    assert begins == "2026-08-14T12:00:00Z begins"
    assert stage.endswith("N01: mesh")
    assert "N01: E = 0.5 MPa (1 of 1)" in done


def test_a_second_run_adds_to_the_log(tmp_path):
    log = tmp_path / "run.log"
    for _ in range(2):
        RunConsole(quiet=True, log=log, now=noon).print("said")
    assert log.read_text().count(HEAD) == 1
    assert log.read_text().count("said") == 2


def test_a_file_of_somebody_else_is_left_as_it_is(tmp_path):
    mine = tmp_path / "batch.toml"
    mine.write_text('category = "plum"\n')
    with pytest.raises(BatchRefused, match="is not a log of drupe"):
        RunConsole(log=mine)
    assert mine.read_text() == 'category = "plum"\n'
    with pytest.raises(BatchRefused, match="cannot be written"):
        RunConsole(log=tmp_path)


@pytest.mark.parametrize(("verbose", "lines"), [(True, 1), (False, 0)])
def test_on_a_terminal_stages_are_lines_where_that_is_asked_for(tmp_path, verbose, lines):
    log = tmp_path / "run.log"
    console = RunConsole(verbose=verbose, log=log, now=noon)
    console.file = shown = io.StringIO()
    console._force_terminal = True
    with BatchProgress(console, total=1) as progress:
        progress.stage("N01", "mesh")
        progress.done("N01", "E = 0.5 MPa")
    assert shown.getvalue().count("] N01: mesh") == lines
    assert log.read_text().count("N01: mesh") == 1


TALKING = """
import logging, os, sys, warnings
from pathlib import Path
import typer
import pipeline.start
from pipeline import cli
from pipeline.run.console import RunConsole

def app(**_):
    RunConsole(log=Path(sys.argv[1]) if sys.argv[1] else None, verbose=sys.argv[2] == "verbose")
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
    "trimesh: failed to load", "KeyError: 'texture'", "UserWarning: deprecated",
    "[Open3D WARNING] no normals",
    "ERROR: In vtkPolyData.cxx",
)  # fmt: skip


@pytest.mark.parametrize("shown", [False, True])
def test_the_terminal_shows_what_libraries_say_only_where_that_is_asked_for(tmp_path, shown):
    log = tmp_path / "run.log"
    command = [sys.executable, "-c", TALKING, str(log), "verbose" if shown else ""]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "drupe's own result\n"
    assert "drupe's own sentence\n" in done.stderr
    assert [library in done.stderr for library in OF_LIBRARIES] == [shown] * len(OF_LIBRARIES)
    if not shown:
        assert done.stderr == "drupe's own sentence\n"
    kept = log.read_text()
    assert all(library in kept for library in OF_LIBRARIES)


def test_without_a_log_what_libraries_say_is_dropped():
    command = [sys.executable, "-c", TALKING, "", ""]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert (done.stdout, done.stderr) == ("drupe's own result\n", "drupe's own sentence\n")


def test_a_line_of_a_library_names_fruit_and_stage(tmp_path):
    log = tmp_path / "run.log"
    console = RunConsole(quiet=True, log=log, now=noon)
    with BatchProgress(console, total=1) as progress:
        progress.stage("N01", "mesh: photo 3 of 20")
        progress.noted("N01", "trimesh: failed to load")
    assert log.read_text().splitlines()[-1] == "2026-08-14T12:00:00Z N01 (mesh): trimesh: failed to load"

"""What a run says on the terminal."""

import io
import os

import pytest
from small_batches import python

from pipeline.run.progress import BatchProgress, RunConsole


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

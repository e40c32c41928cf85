"""What a run says on the terminal, and what a log keeps."""

import io
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
    with BatchProgress(console, total=1, jobs=1) as progress:
        progress.stage("N01", "mesh")
        progress.done("N01", "E = 0.5 MPa", whole=True)
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
    with pytest.raises(BatchRefused, match="is no log of drupe"):
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
    with BatchProgress(console, total=1, jobs=1) as progress:
        progress.stage("N01", "mesh")
        progress.done("N01", "E = 0.5 MPa", whole=True)
    assert shown.getvalue().count("] N01: mesh") == lines
    assert log.read_text().count("N01: mesh") == 1

"""What `drupe watch` says on the terminal."""

import os

import pytest
from watched_batch import QUIET, interrupted, one_by_one, put

from pipeline.watch.watching import BatchWatch

SUMMARY_FROM = 2
"""Lines before the summary: the page's address, and how watching ends."""


@pytest.mark.parametrize("before", [(), ("A",)])
def test_the_command_says_that_ctrl_c_left_a_fruit_unfinished(batch, drupe, worked, before):
    for name in (*before, "stop"):
        put(batch, name)
    ran = drupe("watch", batch, "--settle", "0", "--no-screen", "-q")
    assert worked == [*before, "stop"]
    assert ran.status == 130
    assert "drupe: stopped; a fruit was not finished" in ran.err


@pytest.mark.parametrize("ends", ["when nothing new comes", "by Ctrl-C"])
def test_a_watch_ends_with_the_summary_of_a_plain_grade(batch, drupe, worked, monkeypatch, ends):
    (batch / "fruits.csv").write_text("fruit_id\nA\nB\n")
    for name in "AB":
        put(batch, name)
    if ends == "by Ctrl-C":
        run = BatchWatch.run
        monkeypatch.setattr(BatchWatch, "run", lambda self: (run(self), interrupted()))
    watched = drupe("watch", batch, "--settle", "0", "--idle", "0.01", "--no-screen")
    plain = drupe("grade", batch, "--no-screen")
    assert worked == ["A", "B"]
    assert (watched.status, plain.status) == (0, 0)
    summary = watched.out.splitlines()[SUMMARY_FROM:]
    assert summary == plain.out.splitlines()
    assert "2 of 2 fruit graded" in summary
    assert summary[-2:] == [f"  {batch / 'results' / name}" for name in ("ranking.csv", "report.html")]


def test_fruit_that_were_just_graded_are_not_called_unchanged_but_those_of_an_earlier_run_are(batch, watched):
    watched(*one_by_one(batch, "A", "B"))
    assert "unchanged" not in watched.said.getvalue()
    watched()
    assert watched.said.getvalue().count("2 of 2 fruit unchanged since the last run") == 1


def nothing(_path):
    pass


@pytest.mark.parametrize(
    ("put", "said"),
    [
        (nothing, "does not exist. Write one"),
        (lambda path: path.mkdir(), "is a folder, not a file; put the batch's settings there."),
        (lambda path: path.symlink_to("nowhere"), "is a link to nothing (nowhere)"),
        (os.mkfifo, "is a named pipe, not a file; put the batch's settings there."),
        (lambda path: path.write_bytes(b"\xff\xfe"), "is not UTF-8 text (byte 0xff in line 1)"),
    ],
)
def test_watching_ends_where_there_are_no_settings_to_read(tmp_path, drupe, put, said):
    put(tmp_path / "batch.toml")
    refused(drupe, tmp_path, f"{tmp_path / 'batch.toml'}: {said}")


def test_no_address_is_given_where_watching_cannot_begin(batch, drupe):
    refused(drupe, "nowhere", "nowhere: does not exist; give an existing batch folder.")
    refused(drupe, batch / "batch.toml", "is a file; give the batch folder.")


def refused(drupe, place, said):
    ran = drupe("watch", place)
    assert (ran.status, ran.out) == (2, "")
    assert said in ran.last_line_error()


def test_fruit_that_lack_files_are_named_once_they_are_at_rest(batch, watched):
    put(batch, "A", recording=False)
    watched(*QUIET, lambda: (batch / "fruits" / "B").mkdir(), lambda: put(batch, "B"), *QUIET)
    assert watched.said.getvalue().count("A: not graded yet; missing: a recording in grasps/") == 1
    assert "B: not graded yet" not in watched.said.getvalue()

"""`drupe watch`: fruit are graded as they arrive and change, into its own batch alone; Ctrl-C."""

import errno
import json
import os
import shutil

import pytest
from graded_results import rows
from rich.console import Console
from watched_batch import QUIET, interrupted, one_by_one, put, reports_take

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import FruitFolder
from pipeline.run import grading
from pipeline.run.batch_run import GradeOptions
from pipeline.watch import arrivals, watching
from pipeline.watch.watching import BatchWatch
from reports.kiosk_page import kiosk_html


def test_fruit_are_graded_as_they_come_and_shown_at_once(batch, watched):
    status = watched(lambda: put(batch, "B"), *[lambda: None] * 6, lambda: put(batch, "A"))
    assert status == 0
    assert watched.worked == ["B", "A"]
    assert {name: row["maturity"] for name, row in rows(batch / "results").items()} == {
        "A": "soft",
        "B": "soft",
    }
    assert [entry.recent for entry in watched.shown if entry.batch][-1] == ("A", "B")
    working = [entry.working for entry in watched.shown if entry.working]
    assert working == [("B",), ("A",)]
    assert (batch / "fruits.csv").read_text() == "fruit_id,height_mm\n"


def test_files_that_still_arrive_are_waited_for(batch, watched):
    put(batch, "A", recording=False)
    photo = batch / "fruits" / "A" / "grasps" / "grasp-1.h5"

    def grow():
        with photo.open("a") as file:
            file.write("more")

    watched(*[lambda: None] * 8, *[grow] * 8)
    assert watched.worked == ["A"]
    waiting = [entry.waiting for entry in watched.shown]
    assert waiting[0] == (("A", "a recording in grasps/"),)
    assert waiting[-1] == ()


def test_a_fruit_without_shape_yet_holds_up_no_other(batch, watched):
    """Photos without a mat or a height would stop the whole batch, if it were one of it already."""
    (batch / "fruits" / "B" / "grasps").mkdir(parents=True)
    (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_text("of B")
    (batch / "fruits.csv").write_text("fruit_id,height_mm\nA,\nC,\n")
    put(batch, "A")
    watched()
    assert watched.worked == ["A"]
    assert watched.shown[-1].waiting == (("B", "photos or fruit.ply"),)
    assert watched.shown[-1].expected == 1


def test_a_fruit_that_changes_is_graded_again_and_one_that_does_not_is_not(batch, watched):
    put(batch, "A")
    put(batch, "B")
    watched()
    assert sorted(watched.worked) == ["A", "B"]
    watched(lambda: (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again"))
    assert sorted(watched.worked) == ["A", "B", "B"]
    assert len(rows(batch / "results")) == 2


def test_a_fruit_that_crashed_is_not_tried_at_each_newcomer(batch, watched):
    put(batch, "crash-1")
    status = watched(
        *[lambda: None] * 6, lambda: put(batch, "A"), *[lambda: None] * 6, lambda: put(batch, "B")
    )
    assert watched.worked == ["crash-1", "A", "B"]
    assert status == 3
    assert '<p class="id">B</p>' in kiosk_html(watched.shown[-1])


def test_a_fault_in_the_settings_is_shown_and_mended_while_it_watches(batch, watched):
    put(batch, "A")
    good = (batch / "batch.toml").read_text()
    (batch / "batch.toml").write_text('category = "nectarin"\n')
    watched(*[lambda: None] * 6, lambda: (batch / "batch.toml").write_text(good))
    assert any("nectarin" in problem for entry in watched.shown for problem in entry.problems)
    assert watched.shown[-1].problems == ()
    assert watched.worked == ["A"]


def test_after_a_change_of_settings_all_fruit_are_taken_up_in_one_go(batch, watched):
    for name in "ABC":
        put(batch, name)
    (batch / "notes.txt").write_text("of no account")
    change = (batch / "batch.toml").read_text().replace("0.5", "0.15")
    watched(
        *[lambda: None] * 16,
        lambda: (batch / "notes.txt").write_text("changed"),
        *[lambda: None] * 4,
        lambda: (batch / "batch.toml").write_text(change),
    )
    assert watched.worked == ["A", "B", "C"]
    assert [entry.working for entry in watched.shown if entry.working] == [
        ("A",),
        ("B",),
        ("C",),
        ("A", "B", "C"),
    ]
    assert {row["maturity"] for row in rows(batch / "results").values()} == {"soft", "firm"}


def test_a_deleted_fruit_costs_nothing(batch, watched):
    put(batch, "A")
    put(batch, "B")
    watched(*[lambda: None] * 12, lambda: shutil.rmtree(batch / "fruits" / "A"), lambda: put(batch, "C"))
    assert sorted(rows(batch / "results")) == ["B", "C"]


def test_a_batch_that_is_out_of_reach_for_a_moment_is_shown_and_watched_on(batch, watched):
    """As a network drive is that is mounted anew."""
    away = batch.parent / "away"
    status = watched(
        *one_by_one(batch, "A"),
        lambda: batch.rename(away),
        *[lambda: None] * 4,
        lambda: away.rename(batch),
        *one_by_one(batch, "B"),
    )
    assert (status, watched.worked) == (0, ["A", "B"])
    problems = [problem for entry in watched.shown for problem in entry.problems]
    assert any(
        f"{batch}: drupe cannot process it (No such file or directory)" in problem for problem in problems
    )
    assert watched.shown[-1].problems == ()


@pytest.mark.parametrize("where", ["begun", "grade_queue", "report_of_records"])
def test_so_is_a_file_that_cannot_be_reached_while_fruit_are_graded(batch, watched, monkeypatch, where):
    work, faults = getattr(watching, where), [OSError(errno.ESTALE, "Stale file handle", "a file")]

    def once(*arguments, **named):
        if faults:
            raise faults.pop()
        return work(*arguments, **named)

    monkeypatch.setattr(watching, where, once)
    reports_take(monkeypatch, watched, 1.0)
    status = watched(*one_by_one(batch, "A", "B"), *[lambda: None] * 40)
    assert (status, sorted(set(watched.worked)), faults) == (0, ["A", "B"], [])
    problems = [problem for entry in watched.shown for problem in entry.problems]
    assert "a file: drupe cannot process it (Stale file handle) and tries again." in problems
    assert sorted(rows(batch / "results")) == ["A", "B"]


def test_a_fault_that_ends_it_leaves_the_report_of_what_is_done(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def fault():
        raise ValueError("of drupe")

    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C"), fault)
    with pytest.raises(ValueError, match="of drupe"):
        watch.run()
    assert watched.worked == ["A", "B", "C"]
    assert sorted(rows(batch / "results")) == ["A", "B", "C"]


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


def said_of(batch):
    """Exit status and graded fruit, as batch.json has them."""
    said = json.loads((batch / "results" / "batch.json").read_text())
    return said["exit_status"], sorted(said["outcomes"])


def left(watch, batch):
    """Unfinished fruit, the exit status, fruit in ranking.csv, and what batch.json has."""
    working, status = watch.working, watch.stop()
    return working, status, sorted(rows(batch / "results")), *said_of(batch)


def whole(*names):
    """What is left of a batch none of whose fruit are unfinished."""
    return (), 0, [*names], 0, [*names]


@pytest.fixture
def without_memory(batch, monkeypatch):
    """Leaves no memory to grade with, once the settings of all fruit have changed."""

    def changed():
        monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        with (batch / "batch.toml").open("a") as settings:
            settings.write("[flesh]\nmodel = 'linear'\n")

    return changed


def test_ctrl_c_between_fruit_leaves_ranking_and_report_of_all(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1000.0)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), interrupted)
    assert sorted(rows(batch / "results")) == ["A"]
    for _ in range(2):
        assert left(watch, batch) == whole("A", "B", "C")
        assert made == [1, 3]


def test_ctrl_c_tells_by_its_status_that_the_report_could_not_be_written(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def edited():
        with (batch / "results" / "ranking.csv").open("a") as ranking:
            ranking.write("by hand\n")

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), edited, interrupted)
    assert watch.stop() == 2
    assert (batch / "results" / "ranking.csv").read_text().endswith("by hand\n")
    assert "ranking.csv" in " ".join(watched.shown[-1].problems)


def test_ctrl_c_in_the_middle_of_a_fruit_leaves_those_before_it_and_says_so(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1000.0)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C", "stop"))
    assert left(watch, batch) == (("stop",), 130, ["A", "B", "C"], 130, ["A", "B", "C"])
    assert made == [1]
    assert "Interrupted:</b> 3 of 4 fruit" in (batch / "results" / "report.html").read_text()
    assert watched() == 0
    assert watched.worked == ["A", "B", "C", "stop", "stop"]
    assert sorted(rows(batch / "results")) == ["A", "B", "C", "stop"]


def test_ctrl_c_when_a_fruit_has_just_ended_leaves_none_unfinished(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    newcomer = BatchWatch._with_newcomer

    def stops(self, run, entry, record):
        return interrupted() if record.fruit_id == "C" else newcomer(self, run, entry, record)

    monkeypatch.setattr(BatchWatch, "_with_newcomer", stops)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"))
    assert left(watch, batch) == whole("A", "B", "C")


def test_ctrl_c_after_a_comparison_that_was_refused_half_way_says_what_ranking_csv_holds(
    batch, watched, monkeypatch
):
    """A holds by the new settings, B was to be graded again."""

    def changed():
        monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again")
        (batch / "batch.toml").write_text((batch / "batch.toml").read_text().replace("0.5", "0.15"))

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B"), changed, *QUIET, interrupted)
    assert any("memory" in problem for entry in watched.shown for problem in entry.problems)
    assert watch.reported is None
    assert left(watch, batch)[1:] == (130, ["A"], 130, ["A"])
    assert [fruit.fruit_id for fruit in watch.reported.fruits] == ["A"]


def test_newcomers_are_not_written_through_a_link(batch, watched, monkeypatch, tmp_path):
    reports_take(monkeypatch, watched, 1000.0)
    results, stranger = batch / "results", tmp_path / "stranger"
    stranger.mkdir()

    def linked():
        results.rename(batch / "before")
        results.symlink_to(stranger)

    watch, _ = watched.begun(*one_by_one(batch, "A", "B"), linked, *one_by_one(batch, "C"))
    assert watch.run() == 2
    assert list(stranger.iterdir()) == []
    assert watched.worked == ["A", "B"]
    assert any("is a link" in problem for entry in watched.shown for problem in entry.problems)


def test_newcomers_are_not_written_into_the_results_of_another_batch(batch, watched, monkeypatch, tmp_path):
    """Neither their records nor, between fruit, ranking and report."""
    reports_take(monkeypatch, watched, 1000.0)
    results, other = batch / "results", tmp_path / "tuesday"
    (other / "fruits").mkdir(parents=True)
    shutil.copy(batch / "batch.toml", other)
    (other / "fruits.csv").write_text("fruit_id\nX\n")
    put(other, "X")
    how = GradeOptions(jobs=1, time_limit_s=60, screen=False)
    grading.grade(other, None, how, console=Console(quiet=True))
    theirs = (other / "results" / "ranking.csv").read_text()

    def replaced():
        results.rename(batch / "before")
        shutil.copytree(other / "results", results)

    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C"), replaced, *one_by_one(batch, "D"))
    assert watch.run() == 2
    assert watch.stop() == 2
    assert watched.worked == ["X", "A", "B", "C"]
    assert not (results / "fruits" / "D").exists()
    assert (results / "ranking.csv").read_text() == theirs


@pytest.fixture
def fruit(tmp_path):
    root = tmp_path / "fruits" / "A"
    (root / "grasps").mkdir(parents=True)
    return root


def put_files(*paths):
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("content")


def seen(root):
    """Names of the files that a look sees, from the fruit's folder on."""
    state = arrivals.arrival(FruitFolder(root), FruitRow(fruit_id=root.name)).state
    return {name.removeprefix(f"{root}/") for name, _, _ in state}


def test_parts_of_a_fruit_are_seen_wherever_they_lie(fruit, tmp_path):
    disk = tmp_path / "disk"
    put_files(disk / "photos" / "1.jpg", disk / "grasp" / "grasp.toml", disk / "frames" / "0.png")
    put_files(
        fruit / "fruit.ply", fruit / "grasps" / "grasp-1.h5", fruit / "grasps" / "grasp-2" / "left" / "0.png"
    )
    (fruit / "photos").symlink_to(disk / "photos")
    (fruit / "grasps" / "grasp-3").symlink_to(disk / "grasp")
    (fruit / "grasps" / "grasp-3" / "left").symlink_to(disk / "frames")
    assert seen(fruit) == {
        "fruit.ply",
        "photos/1.jpg",
        "grasps/grasp-1.h5",
        "grasps/grasp-2/left/0.png",
        "grasps/grasp-3/grasp.toml",
        "grasps/grasp-3/left/0.png",
    }


def test_folders_that_are_no_part_of_a_fruit_are_not_entered(fruit, tmp_path):
    """A link may lead to a whole disk, which one look would take minutes to go through."""
    disk = tmp_path / "disk"
    put_files(disk / "deep" / "a" / "b.png", disk / "a.png")
    put_files(fruit / "notes" / "a.txt", fruit / "grasps" / "grasp-1" / "grasp.toml")
    for place in ("x", "grasps/y", "grasps/grasp-1/left"):
        (fruit / place).symlink_to(disk)
    assert seen(fruit) == {"grasps/grasp-1/grasp.toml", "grasps/grasp-1/left/a.png"}


def test_a_look_goes_through_no_more_files_than_a_fruit_may_have(fruit, monkeypatch):
    monkeypatch.setattr(arrivals, "MOST_FILES", 5)
    put_files(*(fruit / "photos" / f"{k}.jpg" for k in range(9)))
    assert len(seen(fruit)) == 5

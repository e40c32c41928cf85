"""`drupe watch`: fruit are graded as they arrive, and when they change."""

import errno
import shutil

import pytest
from graded_results import rows
from watched_batch import one_by_one, put, reports_take

from pipeline.watch import watching
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
    last = kiosk_html(watched.shown[-1])
    assert '<p class="id">B</p>' in last


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

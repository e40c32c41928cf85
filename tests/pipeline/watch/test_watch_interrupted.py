"""Ctrl-C in `drupe watch`: what is left, what is said, and the exit status."""

import json

import pytest
from graded_results import rows
from watched_batch import QUIET, interrupted, one_by_one, reports_take

from pipeline.run import grading
from pipeline.watch.watching import BatchWatch


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
        settings = (batch / "batch.toml").read_text()
        (batch / "batch.toml").write_text(settings.replace("0.5", "0.15"))

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B"), changed, *QUIET, interrupted)
    assert any("memory" in problem for entry in watched.shown for problem in entry.problems)
    assert watch.reported is None
    assert left(watch, batch)[1:] == (130, ["A"], 130, ["A"])
    assert [fruit.fruit_id for fruit in watch.reported.fruits] == ["A"]

"""Ctrl-C in `drupe watch`: what is left, what is said, and the exit status."""

import json
import os

import pytest
from watched_batch import QUIET, interrupted, one_by_one, put, reports_take, rows

from pipeline.run import batch_run, fruit_queue, grading, reporting
from pipeline.watch.watching import BatchWatch


def said_of(batch):
    """Exit status and graded fruit, as batch.json has them."""
    said = json.loads((batch / "results" / "batch.json").read_text())
    return said["exit_status"], sorted(said["outcomes"])


def left(watch, batch):
    """Unfinished fruit, the exit status, fruit in ranking.csv, and what batch.json has."""
    working, status = watch.working, watch.stop()
    return working, status, sorted(rows(batch)), *said_of(batch)


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


def lacks_memory(watched):
    return any("memory" in problem for entry in watched.shown for problem in entry.problems)


def test_ctrl_c_between_fruit_leaves_ranking_and_report_of_all(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1000.0)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), interrupted)
    assert sorted(rows(batch)) == ["A"]
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
    assert sorted(rows(batch)) == ["A", "B", "C", "stop"]


def test_a_fruit_that_could_not_be_graded_again_makes_the_run_an_interrupted_one(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def changed():
        monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        (batch / "fruits" / "A" / "grasps" / "grasp-2.h5").write_text("again")

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), changed, *QUIET, interrupted)
    assert lacks_memory(watched)
    assert left(watch, batch)[1:3] == (130, ["B", "C"])
    assert "Interrupted:</b> 2 of 3 fruit" in (batch / "results" / "report.html").read_text()


def test_ctrl_c_in_the_very_first_report_leaves_no_fruit_unfinished(batch, watched, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(reporting, "report", lambda *_: interrupted())
        watch = watched.until_ctrl_c(*one_by_one(batch, "A"))
    assert watched.worked == ["A"]
    assert left(watch, batch) == whole("A")


@pytest.mark.parametrize("read_again", ["", "A", "AB"])
def test_ctrl_c_while_a_changed_batch_is_read_again_is_an_interrupted_run(
    batch, watched, monkeypatch, read_again
):
    """E of those that were not read again may be another by the new settings."""
    reports_take(monkeypatch, watched, 1000.0)
    settings, reads, read = (batch / "batch.toml").read_text(), fruit_queue.read_record, []

    def stops(path):
        read.append(path.parent.name)
        return interrupted() if "".join(read) not in "AB"[: len(read_again)] else reads(path)

    def changed():
        (batch / "batch.toml").write_text(settings.replace("0.5", "0.15"))
        monkeypatch.setattr(fruit_queue, "read_record", stops)

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), changed)
    unfinished = tuple(name for name in "ABC" if name not in read_again)
    if not read_again:  # nothing is written
        assert left(watch, batch) == (unfinished, 130, ["A"], 0, ["A"])
    else:
        assert left(watch, batch) == (unfinished, 130, [*read_again], 130, [*read_again])


def test_ctrl_c_while_changed_rows_are_read_again_is_an_interrupted_run(batch, watched, monkeypatch):
    def changed():
        (batch / "fruits.csv").write_text("fruit_id,height_mm\nA,55\nB,56\n")
        monkeypatch.setattr(fruit_queue, "read_record", lambda _: interrupted())

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), changed)
    assert left(watch, batch) == (("A", "B"), 130, ["C"], 130, ["C"])


def test_ctrl_c_when_a_fruit_has_just_ended_leaves_none_unfinished(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    newcomer = BatchWatch._with_newcomer

    def stops(self, run, entry, record):
        return interrupted() if record.fruit_id == "C" else newcomer(self, run, entry, record)

    monkeypatch.setattr(BatchWatch, "_with_newcomer", stops)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"))
    assert left(watch, batch) == whole("A", "B", "C")


def test_ctrl_c_before_a_changed_fruit_is_graded_again_says_so(batch, watched, monkeypatch):
    def changed():
        (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again")
        monkeypatch.setattr(batch_run, "require_free", lambda *_: interrupted())

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B"), changed)
    assert watch.working == ("B",)
    monkeypatch.undo()
    assert watch.stop() == 130
    assert said_of(batch) == (130, ["A"])


def test_ctrl_c_before_earlier_results_are_read_leaves_them(batch, watched, monkeypatch):
    for name in "AB":
        put(batch, name)
    assert watched() == 0
    monkeypatch.setattr(fruit_queue, "read_record", lambda _: interrupted())
    assert left(watched.until_ctrl_c(), batch)[1:] == (130, ["A", "B"], 0, ["A", "B"])


def test_ctrl_c_after_a_comparison_that_was_refused_tells_so_by_its_status(batch, watched, without_memory):
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B"), without_memory, *QUIET, interrupted)
    assert lacks_memory(watched)
    assert left(watch, batch)[1:] == (2, ["A", "B"], 0, ["A", "B"])
    assert watch.reported is None


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
    assert lacks_memory(watched)
    assert watch.reported is None
    assert left(watch, batch)[1:] == (130, ["A"], 130, ["A"])
    assert [fruit.fruit_id for fruit in watch.reported.fruits] == ["A"]


def test_settings_that_were_refused_and_are_undone_leave_a_whole_batch(
    batch, watched, monkeypatch, without_memory
):
    memory_MiB, settings = grading.free_memory_MiB, (batch / "batch.toml").read_text()
    at = (batch / "batch.toml").stat()

    def undone():
        monkeypatch.setattr(grading, "free_memory_MiB", memory_MiB)
        (batch / "batch.toml").write_text(settings)
        os.utime(batch / "batch.toml", ns=(at.st_atime_ns, at.st_mtime_ns))

    assert watched(*one_by_one(batch, "A", "B")) == 0
    assert watched(without_memory, *QUIET, undone) == 0
    assert lacks_memory(watched)
    assert said_of(batch) == (0, ["A", "B"])


def test_a_comparison_that_was_refused_is_forgotten_when_one_is_made(
    batch, watched, monkeypatch, without_memory
):
    memory_MiB = grading.free_memory_MiB
    watch = watched.until_ctrl_c(
        *one_by_one(batch, "A", "B"),
        without_memory,
        *QUIET,
        lambda: monkeypatch.setattr(grading, "free_memory_MiB", memory_MiB),
        *[lambda: None] * 40,
        interrupted,
    )
    assert watch.stop() == 0
    assert said_of(batch) == (0, ["A", "B"])

"""Ctrl-C in `drupe watch`: what is left, what is said, and the exit status."""

import json
import os
from functools import partial

import pytest
from watched_batch import QUIET, interrupted, of_another, one_by_one, put, reports_take, rows

from pipeline.run import fruit_queue, grading, incremental_run
from pipeline.run.incremental_ranking import IncrementalRanking


def said_of(batch):
    """Exit status and graded fruit, as batch.json has them."""
    said = json.loads((batch / "results" / "batch.json").read_text())
    return said["exit_status"], sorted(said["outcomes"])


def left(watch, batch):
    """Unfinished fruit, the exit status, fruit in ranking.csv, and what batch.json has."""
    working, status = watch.graded.working, watch.stop()
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
    assert sorted(rows(batch)) == ["A", "B"]
    for _ in range(2):
        assert left(watch, batch) == whole("A", "B", "C")
        assert made == [1, 2, 3]


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
    assert made == [1, 2]
    assert "Interrupted:</b> 3 of 4 fruit" in (batch / "results" / "report.html").read_text()
    assert watched() == 0
    assert watched.worked == ["A", "B", "C", "stop", "stop"]
    assert sorted(rows(batch)) == ["A", "B", "C", "stop"]


def test_ctrl_c_while_a_fruit_is_graded_again_for_a_newcomer_says_so(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def stops_again():
        watched.worked[:] = [name for name in watched.worked if name != "stop"]

    watched.worked.append("stop")  # it is graded once before Ctrl-C comes
    names_b = partial(of_another, batch, "stop", "B")
    watch = watched.until_ctrl_c(
        *one_by_one(batch, "D"), names_b, *QUIET, stops_again, *one_by_one(batch, "B")
    )
    assert watched.worked == ["D", "B", "stop"]
    assert left(watch, batch) == (("stop",), 130, ["B", "D"], 130, ["B", "D"])
    assert "Interrupted:</b> 2 of 3 fruit" in (batch / "results" / "report.html").read_text()


def test_a_fruit_that_could_not_be_graded_again_makes_the_run_an_interrupted_one(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def changed():
        monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        (batch / "fruits" / "A" / "grasps" / "grasp-2.h5").write_text("again")

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), changed, *QUIET, interrupted)
    assert lacks_memory(watched)
    assert left(watch, batch)[1:3] == (130, ["B", "C"])
    assert "Interrupted:</b> 2 of 3 fruit" in (batch / "results" / "report.html").read_text()


@pytest.mark.parametrize("place", ["FruitQueue", "report"])
def test_ctrl_c_in_the_last_comparison_leaves_ranking_and_report_of_all(batch, watched, monkeypatch, place):
    made, grades = reports_take(monkeypatch, watched, 1000.0), incremental_run.grade

    def interrupted_there(*arguments, **how):
        with monkeypatch.context() as patch:
            if how["retried"] == []:
                patch.setattr(grading, place, lambda *_, **__: interrupted())
            return grades(*arguments, **how)

    monkeypatch.setattr(incremental_run, "grade", interrupted_there)
    watch = watched.until_ctrl_c(*one_by_one(batch, *"ABCDE"))
    assert sorted(rows(batch)) == ["A", "B"]
    assert left(watch, batch) == whole(*"ABCDE")
    assert made == [1, 2, 5]


def test_ctrl_c_while_the_last_comparison_grades_a_fruit_again_says_so(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    watched.worked.append("stop")  # it is graded once before Ctrl-C comes
    grades = incremental_run.grade

    def once_more(*arguments, **how):
        if how["retried"] == []:
            (batch / "results" / "fruits" / "stop" / "record.json").unlink()
            watched.worked.clear()
        return grades(*arguments, **how)

    monkeypatch.setattr(incremental_run, "grade", once_more)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "stop", "B"))
    assert left(watch, batch) == (("stop",), 130, ["A", "B"], 130, ["A", "B"])


def test_ctrl_c_in_the_very_first_report_leaves_no_fruit_unfinished(batch, watched, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(grading, "report", lambda *_: interrupted())
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
    ranked = [*(read_again or "AB")]  # where none was read again, those of the report before
    assert left(watch, batch) == (unfinished, 130, ranked, 130, [*read_again])


def test_ctrl_c_while_changed_rows_are_read_again_is_an_interrupted_run(batch, watched, monkeypatch):
    def changed():
        (batch / "fruits.csv").write_text("fruit_id,height_mm\nA,55\nB,56\n")
        monkeypatch.setattr(fruit_queue, "read_record", lambda _: interrupted())

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"), changed)
    assert left(watch, batch) == (("A", "B"), 130, ["C"], 130, ["C"])


def test_ctrl_c_when_a_fruit_has_just_ended_leaves_none_unfinished(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    add = IncrementalRanking.add

    def stops(self, run, record):
        return interrupted() if record.fruit_id == "C" else add(self, run, record)

    monkeypatch.setattr(IncrementalRanking, "add", stops)
    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B", "C"))
    assert left(watch, batch) == whole("A", "B", "C")


def test_ctrl_c_before_a_changed_fruit_is_graded_again_says_so(batch, watched, monkeypatch):
    def changed():
        (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again")
        monkeypatch.setattr(grading, "require_free", lambda *_: interrupted())

    watch = watched.until_ctrl_c(*one_by_one(batch, "A", "B"), changed)
    assert watch.graded.working == ("B",)
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
    assert left(watch, batch)[1:] == (2, ["A", "B"], 2, [])
    assert sorted(fruit.fruit_id for fruit in watch.graded.reported.fruits) == ["A", "B"]


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
    assert sorted(rows(batch)) == ["A"]
    assert watch.graded.reported is None
    assert left(watch, batch)[1:] == (130, ["A"], 130, ["A"])
    assert [fruit.fruit_id for fruit in watch.graded.reported.fruits] == ["A"]


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


def test_ctrl_c_when_a_newcomer_is_about_to_be_told_of_leaves_a_report_of_the_others(batch, watched):
    """Of A, whose recording names B, too, that it is not finished."""
    of_another(batch, "A", "B")
    watch, _ = watched.begun(*one_by_one(batch, "D"), *one_by_one(batch, "B"))
    show = watch.show
    watch.show = lambda entry: interrupted() if entry.working[:1] == ("B",) else show(entry)
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    watch.show = show
    assert left(watch, batch) == (("B", "A"), 130, ["D"], 130, ["D"])


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

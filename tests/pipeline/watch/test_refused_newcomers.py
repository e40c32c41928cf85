"""Newcomers that `drupe watch` cannot grade: what others keep, and what is left when they are gone."""

import shutil

import pytest
from graded_results import rows
from watched_batch import QUIET, of_another, one_by_one, put

from pipeline.run import grading

LATER = [lambda: None] * 40
"""Enough looks for what was refused to be tried again."""


def in_the_way(batch, name):
    """A file of somebody else's where the fruit's results go."""
    place = batch / "results" / "fruits" / name
    place.mkdir(parents=True)
    (place / "record.json").write_text("somebody else's")


def taken_away(batch, name):
    shutil.rmtree(batch / "fruits" / name)


def problems(watched):
    return {problem for entry in watched.shown for problem in entry.problems}


def test_a_fruit_keeps_its_record_when_a_newcomer_that_it_names_is_refused(batch, watched):
    put(batch, "D")
    of_another(batch, "A", "B")
    assert watched() == 0
    status = watched(
        lambda: in_the_way(batch, "B"), *one_by_one(batch, "B"), lambda: taken_away(batch, "B"), *LATER
    )
    assert any("fruits/B/record.json" in problem for problem in problems(watched))
    assert (status, sorted(rows(batch / "results"))) == (0, ["A", "D"])


def test_a_newcomer_that_is_still_refused_is_said_by_the_status(batch, watched):
    assert watched(*one_by_one(batch, "A"), lambda: in_the_way(batch, "N9"), *one_by_one(batch, "N9")) == 2
    assert sorted(rows(batch / "results")) == ["A"]


def changed(batch, name):
    (batch / "fruits" / name / "grasps" / "grasp-2.h5").write_text("again")


def as_before(batch, name):
    (batch / "fruits" / name / "grasps" / "grasp-2.h5").unlink()


@pytest.mark.parametrize("why", ["place", "memory"])
@pytest.mark.parametrize("then", [as_before, taken_away])
def test_a_changed_fruit_that_was_refused_and_is_as_before_or_gone_leaves_a_whole_batch(
    batch, watched, monkeypatch, why, then
):
    memory_MiB = grading.free_memory_MiB

    def refused():
        changed(batch, "B")
        if why == "memory":
            monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        else:
            (batch / "results" / "fruits" / "B").rename(batch / "B before")
            (batch / "results" / "fruits" / "B").symlink_to(batch / "B before")

    def restored():
        then(batch, "B")
        if why == "memory":
            monkeypatch.setattr(grading, "free_memory_MiB", memory_MiB)
        else:
            (batch / "results" / "fruits" / "B").unlink()
            (batch / "B before").rename(batch / "results" / "fruits" / "B")

    assert watched(*one_by_one(batch, "A", "B")) == 0
    status = watched(refused, *QUIET, restored, *LATER)
    assert problems(watched)
    assert (status, sorted(rows(batch / "results"))) == (0, ["A", "B"] if then is as_before else ["A"])

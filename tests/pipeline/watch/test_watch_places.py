"""`drupe watch` writes into its own batch's results alone."""

import shutil

from rich.console import Console
from watched_batch import one_by_one, put, reports_take

from pipeline.run import grading
from pipeline.run.batch_run import GradeOptions


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

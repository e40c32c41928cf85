"""A worker that is not what a run needs says so in a sentence, before any fruit is lost on it."""

from pathlib import Path

import pytest
from cluster_work import needs_of

from pipeline.run import runner
from pipeline.run.cluster_worker import FruitOrder, fruit_here, unfit
from pipeline.run.runner import LocalPool
from pipeline.run.scheduling import Died, run_on

NOWHERE = Path("/nowhere/.run.json")


def said(needs, *, threads=1, most_MiB=None):
    return unfit(needs, threads=threads, most_MiB=most_MiB)


@pytest.mark.parametrize("most_MiB", [None, 100.0])
def test_one_that_is_as_this_machine_is_fit(tmp_path, most_MiB):
    assert said(needs_of(tmp_path), most_MiB=most_MiB) == ""


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"drupe": "drupe 9.9"}, "but this command runs drupe 9.9. Install the same on both"),
        ({"mark": "another run"}, "as this command does: OUT must lie on a file system that all machines"),
        ({"settings": NOWHERE}, f"does not find {NOWHERE}: BATCH must lie on a file system"),
        ({"run": NOWHERE}, f"does not see {NOWHERE.parent} as this command does: OUT must lie"),
    ],
)
def test_what_differs_is_named(tmp_path, changed, sentence):
    assert sentence in said(needs_of(tmp_path, **changed))


@pytest.mark.parametrize(
    ("worker", "sentence"),
    [
        ({"threads": 8}, "has 8 threads, expected 1 (one fruit at a time); start it with --nthreads 1."),
        (
            {"most_MiB": 99.0},
            "has 99 MiB of memory per fruit, but a fruit needs about 100 MiB. "
            "Start it with --memory-limit 600MiB or",
        ),
    ],
)
def test_threads_and_memory_are_named_with_what_to_start_it_with(tmp_path, worker, sentence):
    assert said(needs_of(tmp_path), **worker).startswith(sentence)


def test_results_that_cannot_be_written_to_are_named(tmp_path, monkeypatch):
    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pipeline.run.cluster_worker.tempfile.TemporaryFile", refused)
    assert "(Permission denied): OUT must lie" in said(needs_of(tmp_path))


def test_a_fruit_whose_process_cannot_be_made_ends_alike_here_and_on_a_worker(tmp_path, monkeypatch):
    def refused(*_):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(runner, "_started", refused)
    order = FruitOrder(fruit_id="a", packed=b"", time_limit_s=9.0, needs=needs_of(tmp_path))
    ended = Died("a", None, "its process did not start: Resource temporarily unavailable")
    assert fruit_here(order, tell=print, wanted=lambda: True, most_MiB=None) == ended
    assert list(run_on(LocalPool(jobs=1, time_limit_s=9.0), print, [("a", 1)])) == [ended]

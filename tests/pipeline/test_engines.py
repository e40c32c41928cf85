"""What is asked for that is not there is refused in a sentence; an engine gets no more than it takes."""

import pytest
from cluster_work import needs_of

from pipeline.problem import BatchRefused
from pipeline.run import cluster
from pipeline.run.cluster import Cluster
from pipeline.run.scheduling import Died, Finished, WorkPlace, run_on


class Few:
    """An engine that takes two fruit at a time and ends them in the order in which they came."""

    def __init__(self):
        self.held, self.most = [], 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.held.clear()

    def room(self):
        return 2 - len(self.held)

    def begin(self, fruit_id, packed):
        if fruit_id == "unlucky":
            raise OSError("no process can be made")
        self.held.append(fruit_id)
        self.most = max(self.most, len(self.held))

    def happened(self):
        fruit_id = self.held.pop(0)
        yield Finished(fruit_id, fruit_id)


def test_tasks_are_taken_as_there_is_room():
    engine, taken = Few(), []

    def tasks():
        for k in range(10):
            taken.append(k)
            yield str(k), None

    events = run_on(engine, print, tasks())
    next(events)
    assert taken == [0, 1]
    assert [event.fruit_id for event in events] == [str(k) for k in range(1, 10)]
    assert engine.most == 2


def test_one_that_cannot_be_begun_costs_itself_alone():
    events = list(run_on(Few(), print, [(name, None) for name in ("a", "unlucky", "b")]))
    assert sorted(events, key=lambda event: event.fruit_id) == [
        Finished("a", "a"), Finished("b", "b"),
        Died("unlucky", None, "its process did not start: no process can be made"),
    ]  # fmt: skip


def cluster_at(address, folder):
    return Cluster(address, workers=2, needs=needs_of(folder), time_limit_s=9, tell=print)


def test_a_scheduler_that_does_not_answer_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with pytest.raises(BatchRefused) as refused:
        list(run_on(cluster_at("tcp://127.0.0.1:9", tmp_path), print, []))
    assert str(refused.value).startswith("tcp://127.0.0.1:9: no dask scheduler answers there (")
    assert "start one with `dask scheduler`" in str(refused.value)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"slurm": True, "scheduler": "tcp://a:1", "jobs": 2}, "--slurm: conflicts with --scheduler"),
        ({"slurm": True}, "--slurm: needs --jobs, the number of Slurm jobs."),
        (
            {"scheduler": "node1"},
            '--scheduler: found "node1"; expected the address that `dask scheduler` prints',
        ),
    ],
)
def test_what_contradicts_itself_is_refused(asked, sentence):
    with pytest.raises(BatchRefused, match=sentence):
        WorkPlace(**asked).require_parts()


@pytest.mark.parametrize(
    ("asked", "option"),
    [({"slurm": True, "jobs": 1}, "--slurm"), ({"scheduler": "tcp://a:1"}, "--scheduler")],
)
def test_an_extra_that_is_not_installed_is_named(asked, option, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BatchRefused, match=rf"{option}: needs .* pip install 'drupe\[cluster\]'"):
        WorkPlace(**asked).require_parts()


def test_slurm_without_sbatch_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BatchRefused, match="--slurm: found no sbatch"):
        list(run_on(cluster_at(None, tmp_path), print, []))

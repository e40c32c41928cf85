"""A run on a cluster whose scheduler, workers and connection fail one at a time, without any of them."""

from types import SimpleNamespace

import pytest
from cluster_work import needs_of
from distributed import KilledWorker

from pipeline.problem import BatchRefused
from pipeline.run import cluster
from pipeline.run.cluster import Cluster
from pipeline.run.cluster_worker import Unfit
from pipeline.run.scheduling import Died, Finished, Progressed

A, B = "tcp://a:1", "tcp://b:1"
DONE = Finished("peach", "done")


class GivenFruit:
    """A future of dask's."""

    status = "pending"

    def add_done_callback(self, callback):
        self.callback = callback

    def result(self, timeout):
        if isinstance(self.ended, Exception):
            raise self.ended
        return self.ended

    def end(self, ended):
        self.ended, self.status = ended, "error" if isinstance(ended, Exception) else "finished"
        self.callback(self)


class Scheduler:
    """What one of dask's holds: its workers, and what it was given."""

    def __init__(self, *workers):
        self.workers = dict.fromkeys(workers)
        self.given, self.clients = [], []

    def client(self, address, **_):
        self.clients.append(Connected(self))
        return self.clients[-1]


class Connected:
    """A client of dask's."""

    def __init__(self, scheduler):
        self.scheduler, self.status, self.scheduler_comm = scheduler, "running", object()
        self.dashboard_link, self.cancelled = "http://there:8787/status", []

    def subscribe_topic(self, topic, callback):
        self.callback = callback

    def scheduler_info(self, n_workers):
        return {"workers": dict(self.scheduler.workers)} if self.status == "running" else {}

    def submit(self, function, order, *, key, pure):
        self.scheduler.given.append(GivenFruit())
        return self.scheduler.given[-1]

    def cancel(self, futures, force):
        self.cancelled += futures

    def close(self, timeout):
        self.status = "closed"


@pytest.fixture
def scheduler(monkeypatch):
    scheduler = Scheduler(A, B)
    monkeypatch.setattr(cluster, "Client", scheduler.client)
    monkeypatch.setattr(cluster, "packed_fruit", lambda order, topic: order)
    monkeypatch.setattr(cluster, "COUNT_S", -1.0)
    monkeypatch.setattr(cluster, "LOOK_S", 0.001)
    return scheduler


@pytest.fixture
def said():
    return []


@pytest.fixture
def engine(scheduler, said, tmp_path):
    def engine(**options):
        needs = needs_of(tmp_path)
        return Cluster("tcp://there:8786", needs=needs, time_limit_s=60.0, tell=said.append, **options)

    return engine


def happened(engine):
    return list(engine.happened())


@pytest.mark.parametrize("comes_back", [False, True])
def test_a_run_whose_scheduler_is_lost_is_refused(engine, scheduler, comes_back):
    """Also where the client has joined it again by itself: that one has no fruit of ours any more."""
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        if comes_back:
            scheduler.clients[0].scheduler_comm = object()
        else:
            scheduler.clients[0].status = "closed"
            scheduler.given[0].end(RuntimeError("cancelled"))
        with pytest.raises(BatchRefused, match=r"scheduler is lost. drupe kept the finished fruit; run the"):
            happened(cluster_engine)


def test_stages_endings_and_what_is_given_up_are_told(engine, scheduler, said):
    with engine() as cluster_engine:
        for name in ("peach", "plum"):
            cluster_engine.begin(name, b"")
        assert cluster_engine.room() == 0
        scheduler.clients[0].callback((0.0, ("peach", "modulus")))
        scheduler.given[0].end(DONE)
        scheduler.given[1].end(KilledWorker("plum", SimpleNamespace(address=A), 1))
        died = Died("plum", None, f"2 workers died with it, the last {A}")
        assert happened(cluster_engine) == [Progressed("peach", "modulus"), DONE, died]
    assert said == ["cluster at tcp://there:8786: 2 workers; dashboard http://there:8787/status"]


@pytest.mark.parametrize(
    ("ended", "sentence"),
    [
        (Unfit("has 8 threads.", A), f"^worker {A}: has 8 threads.$"),
        (ImportError("no drupe"), "a worker cannot load this drupe"),
        (AttributeError("no fruit_on_worker"), "a worker cannot load this drupe"),
    ],
)
def test_a_worker_that_cannot_work_for_the_run_refuses_it(engine, scheduler, ended, sentence):
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        scheduler.given[0].end(ended)
        with pytest.raises(BatchRefused, match=sentence):
            happened(cluster_engine)


def test_no_more_fruit_than_asked_for_are_in_the_cluster(engine):
    with engine(most=1) as cluster_engine:
        assert cluster_engine.room() == 1

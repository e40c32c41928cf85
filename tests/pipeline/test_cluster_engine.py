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

    def __init__(self, fruit_id, options):
        self.fruit_id, self.options, self.status = fruit_id, options, "pending"

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
        self.given, self.clients, self.answers = [], [], {}

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

    def run(self, function, *_, on_error):
        return self.scheduler.answers

    def submit(self, function, order, *, key, pure, **options):
        self.scheduler.given.append(GivenFruit(order.fruit_id, options))
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


def test_a_fruit_that_is_lost_on_the_way_is_begun_again(engine, scheduler):
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        scheduler.given[0].end(TimeoutError())
        scheduler.given[0].status = "lost"
        assert happened(cluster_engine) == []
        scheduler.given[1].end(DONE)
        assert happened(cluster_engine) == [DONE]


def test_a_worker_that_is_not_fit_is_left_out_and_said_once(engine, scheduler, said):
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        cluster_engine.begin("plum", b"")
        assert scheduler.given[0].options["workers"] is None
        for fruit in scheduler.given[:2]:
            fruit.end(Unfit("has 8 threads.", A))
        assert happened(cluster_engine) == []
        assert [line for line in said if "threads" in line] == [f"left out: worker {A}: has 8 threads."]
        assert [fruit.options["workers"] for fruit in scheduler.given[2:]] == [[B], [B]]
        assert cluster_engine.at_once == 1
        scheduler.given[2].end(DONE)
        assert happened(cluster_engine) == [DONE]
        scheduler.given[3].end(Unfit("cannot write.", B))
        with pytest.raises(BatchRefused, match=f"worker {B}: cannot write."):
            happened(cluster_engine)


def test_fruit_go_on_where_the_workers_they_were_kept_for_are_gone(engine, scheduler):
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        scheduler.given[0].end(Unfit("has 8 threads.", A))
        happened(cluster_engine)
        del scheduler.workers[B]
        happened(cluster_engine)
        assert len(scheduler.given) == 2
        scheduler.workers["tcp://c:1"] = None
        happened(cluster_engine)
        assert [fruit.options["workers"] for fruit in scheduler.given] == [None, [B], ["tcp://c:1"]]
        assert scheduler.clients[0].cancelled == [scheduler.given[1]]
        scheduler.given[2].end(DONE)
        assert happened(cluster_engine) == [DONE]


def test_at_the_start_a_worker_that_is_not_fit_is_left_out_and_none_is_refused(engine, scheduler, said):
    scheduler.answers = {A: "has 8 threads.", B: ""}
    with engine() as cluster_engine:
        assert cluster_engine.at_once == 1
    assert said[0] == f"left out: worker {A}: has 8 threads."
    scheduler.answers[B] = ImportError("no drupe")
    with pytest.raises(BatchRefused) as refused, engine():
        pass
    first, second = map(str, refused.value.problems)
    assert first == f"worker {A}: has 8 threads."
    assert second.startswith(f"worker {B}: cannot load this drupe (ImportError: no drupe); install")


@pytest.mark.parametrize("error", [ImportError("no drupe"), AttributeError("no fruit_on_worker")])
def test_a_worker_that_cannot_load_its_fruit_is_found_and_left_out(engine, scheduler, said, error):
    """It came later and fails fast: two fruit are back before it is known."""
    late = "tcp://late:1"
    with engine() as cluster_engine:
        scheduler.workers[late] = None
        cluster_engine.begin("peach", b"")
        cluster_engine.begin("plum", b"")
        scheduler.answers = {A: "", B: "", late: error}
        for fruit in scheduler.given[:2]:
            fruit.end(error)
        assert happened(cluster_engine) == []
        again = [(fruit.fruit_id, fruit.options["workers"]) for fruit in scheduler.given[2:]]
        assert again == [("peach", [A, B]), ("plum", [A, B])]
        assert cluster_engine.at_once == 2
        scheduler.given[2].end(DONE)
        assert happened(cluster_engine) == [DONE]
    (left_out,) = (line for line in said if line.startswith("left out: "))
    assert left_out.startswith(f"left out: worker {late}: cannot load this drupe ({type(error).__name__}: ")


def test_a_run_is_refused_where_every_worker_cannot_load_its_fruit(engine, scheduler):
    """A is left out first; where B cannot either, no other is there."""
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        scheduler.answers = {A: ImportError("no drupe"), B: ""}
        scheduler.given[0].end(ImportError("no drupe"))
        assert happened(cluster_engine) == []
        scheduler.answers[B] = ImportError("no drupe")
        scheduler.given[1].end(ImportError("no drupe"))
        with pytest.raises(BatchRefused, match=f"^2 workers \\({A}, ...\\): cannot load this drupe"):
            happened(cluster_engine)


def test_a_fruit_that_a_fit_worker_cannot_load_again_refuses_the_run(engine, scheduler):
    """One unfit worker that was found is no cause for a second failure."""
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        scheduler.answers = {A: ImportError("no drupe"), B: ""}
        for given in range(2):
            scheduler.given[given].end(ImportError("no drupe"))
            if given == 0:
                assert happened(cluster_engine) == []
        with pytest.raises(BatchRefused, match="a worker cannot load this drupe"):
            happened(cluster_engine)


def test_one_that_cannot_be_found_refuses_the_run(engine, scheduler):
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        scheduler.given[0].end(ImportError("no drupe"))
        with pytest.raises(BatchRefused, match="a worker cannot load this drupe"):
            happened(cluster_engine)


def test_being_without_workers_is_said_again_and_again(engine, scheduler, said, monkeypatch):
    scheduler.workers.clear()
    now_s = [0.0]
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    with engine() as cluster_engine:
        cluster_engine.begin("peach", b"")
        for _ in range(12):
            now_s[0] += 60.0
            happened(cluster_engine)
        scheduler.workers[A] = None
        for _ in range(12):
            now_s[0] += 60.0
            happened(cluster_engine)
    start = "dask worker tcp://there:8786 --nthreads 1"
    assert said[1:] == [
        f"waiting for workers ({start})",
        f"no worker for 6 min; 1 fruit wait ({start})",
        f"no worker for 12 min; 1 fruit wait ({start})",
    ]


def test_no_more_fruit_than_asked_for_are_in_the_cluster(engine):
    with engine(most=1) as cluster_engine:
        assert cluster_engine.room() == 1

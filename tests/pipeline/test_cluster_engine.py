"""A run on a cluster whose scheduler, workers and connection fail one at a time, without any of them."""

import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import SimpleNamespace

import pytest
from cluster_work import needs_of
from distributed import KilledWorker

from pipeline.problem import BatchRefused
from pipeline.run import cluster
from pipeline.run.cluster import Cluster, ClusterPlace
from pipeline.run.cluster_worker import Unfit
from pipeline.run.scheduling import Died, Finished, Progressed
from pipeline.run.slurm_jobs import MEMORY
from pipeline.run.worker_tasks import BEGUN

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
    """What one of dask's holds: its workers and the resources they declare, and what it was given."""

    def __init__(self, workers):
        self.workers = {address: {"resources": resources} for address, resources in workers.items()}
        self.given, self.clients, self.answers, self.link = [], [], {}, None

    def client(self, address, **_):
        self.clients.append(Connected(self))
        return self.clients[-1]


class Connected:
    """A client of dask's."""

    def __init__(self, scheduler):
        self.scheduler, self.status, self.scheduler_comm = scheduler, "running", object()
        self.dashboard_link, self.topics, self.cancelled = scheduler.link, [], []

    def subscribe_topic(self, topic, callback):
        self.topics.append(topic)
        self.callback = callback

    def scheduler_info(self, n_workers):
        return {"workers": dict(self.scheduler.workers)} if self.status == "running" else {}

    def run(self, function, *_, on_error):
        return self.scheduler.answers

    def submit(self, function, order, *, key, pure, **options):
        if self.status != "running":
            raise RuntimeError("Client is closed.")  # dask's own is no OSError either
        self.scheduler.given.append(GivenFruit(order.fruit_id, options))
        return self.scheduler.given[-1]

    def cancel(self, futures, force):
        self.cancelled += futures

    def close(self, timeout):
        self.status = "closed"


@pytest.fixture
def scheduler(monkeypatch):
    scheduler = Scheduler({A: {}, B: {}})
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
        place = ClusterPlace(address="tcp://there:8786")
        return Cluster(place, needs=needs_of(tmp_path), time_limit_s=60.0, tell=said.append, **options)

    return engine


def happened(engine):
    return list(engine.happened())


@pytest.mark.parametrize("call", [Cluster.room, lambda one: one.begin("plum", b""), happened])
def test_a_client_that_is_closed_is_replaced_and_gets_every_fruit_again(engine, scheduler, said, call):
    with engine() as one:
        one.begin("peach", b"")
        scheduler.clients[0].status = "closed"
        call(one)
        assert [fruit.fruit_id for fruit in scheduler.given][:2] == ["peach", "peach"]
        scheduler.given[1].end(DONE)
        assert happened(one) == [DONE]
    assert said[1:] == [
        "the scheduler at tcp://there:8786 does not answer; 1 fruit wait for it (at most 10 min)",
        "the scheduler answers again, with 2 workers",
    ]


def test_a_client_that_closes_while_it_is_asked_costs_nothing(engine, scheduler):
    """The connection is lost between the look at it and the call."""
    with engine() as one:
        one.begin("peach", b"")
        scheduler.clients[0].status = "closed"
        one._count()
        assert one.at_once == 2
        one._submit(one._fruits["peach"])
        scheduler.given[0].end(RuntimeError("cancelled"))
        assert happened(one) == []
        scheduler.given[-1].end(DONE)
        assert happened(one) == [DONE]


def test_one_that_came_back_by_itself_hears_of_stages_again(engine, scheduler):
    with engine() as one:
        one.begin("peach", b"")
        scheduler.clients[0].scheduler_comm = object()
        happened(one)
        assert scheduler.clients[1].topics == scheduler.clients[0].topics != []
        scheduler.clients[1].callback((0.0, ("peach", "modulus")))
        assert happened(one) == [Progressed("peach", "modulus")]
        assert len(scheduler.given) == 2


@pytest.mark.parametrize(("begun", "ends"), [(0, 2), (1, 2), (2, 1)])
def test_a_fruit_that_dask_gives_up_is_given_up_after_a_few_times_at_most(engine, scheduler, begun, ends):
    """Also where no worker was heard to begin with it; one lost worker is allowed."""
    killed = KilledWorker("peach", SimpleNamespace(address=A), 1)
    with engine() as one:
        one.begin("peach", b"")
        for _ in range(begun):
            scheduler.clients[0].callback((0.0, ("peach", BEGUN)))
        for _ in range(ends - 1):
            scheduler.given[-1].end(killed)
            assert happened(one) == []
        scheduler.given[-1].end(killed)
        assert happened(one) == [Died("peach", None, f"2 workers died with it, the last {A}")]


def test_a_worker_that_is_not_fit_is_left_out_and_said_once(engine, scheduler, said):
    with engine() as one:
        one.begin("peach", b"")
        one.begin("plum", b"")
        assert scheduler.given[0].options["workers"] is None
        for fruit in scheduler.given[:2]:
            fruit.end(Unfit("has 8 threads.", A))
        assert happened(one) == []
        assert [line for line in said if "threads" in line] == [f"left out: worker {A}: has 8 threads."]
        assert [fruit.options["workers"] for fruit in scheduler.given[2:]] == [[B], [B]]
        assert one.at_once == 1
        scheduler.given[2].end(DONE)
        assert happened(one) == [DONE]
        scheduler.given[3].end(Unfit("cannot write.", B))
        with pytest.raises(BatchRefused, match=f"worker {B}: cannot write."):
            happened(one)


def test_fruit_go_on_where_the_workers_they_were_kept_for_are_gone(engine, scheduler):
    with engine() as one:
        one.begin("peach", b"")
        scheduler.given[0].end(Unfit("has 8 threads.", A))
        happened(one)
        del scheduler.workers[B]
        scheduler.workers["tcp://c:1"] = {"resources": {}}
        happened(one)
        assert [fruit.options["workers"] for fruit in scheduler.given] == [None, [B], ["tcp://c:1"]]
        assert scheduler.clients[0].cancelled == [scheduler.given[1]]


def test_at_the_start_a_worker_that_is_not_fit_is_left_out_and_none_is_refused(engine, scheduler, said):
    scheduler.answers = {A: "has 8 threads.", B: ""}
    with engine() as one:
        assert one.at_once == 1
    assert said[0] == f"left out: worker {A}: has 8 threads."
    scheduler.answers[B] = ImportError("no drupe")
    with pytest.raises(BatchRefused) as refused, engine():
        pass
    first, second = map(str, refused.value.problems)
    assert first == f"worker {A}: has 8 threads."
    assert second.startswith(f"worker {B}: cannot load this drupe (ImportError: no drupe); install")


def test_a_worker_that_cannot_load_a_fruit_is_found_and_left_out(engine, scheduler, said):
    with engine() as one:
        one.begin("peach", b"")
        scheduler.answers = {A: "", B: ImportError("no drupe")}
        scheduler.given[0].end(ImportError("no drupe"))
        assert happened(one) == []
        assert scheduler.given[1].options["workers"] == [A]
        assert any(line.startswith(f"left out: worker {B}: cannot load this drupe") for line in said)


def test_one_that_cannot_be_found_refuses_the_run(engine, scheduler):
    with engine() as one:
        one.begin("peach", b"")
        scheduler.given[0].end(ImportError("no drupe"))
        with pytest.raises(BatchRefused, match="a worker cannot load this drupe"):
            happened(one)


def test_the_worker_that_declares_too_little_memory_is_the_one_named(engine, scheduler, said):
    scheduler.workers = {A: {"resources": {MEMORY: 2e9}}, B: {"resources": {MEMORY: 5e7}}}
    sentence = f"worker {B}: declares MEMORY=50000000 (bytes), but one fruit needs 104857600."
    with engine() as one:
        one.begin("peach", b"")
        assert scheduler.given[0].options["resources"] == {MEMORY: 104857600.0}
    assert said[0] == f"left out: {sentence}"
    del scheduler.workers[A]
    with pytest.raises(BatchRefused, match=r"^worker tcp://b:1: declares MEMORY=50000000 "), engine():
        pass


def test_a_fruit_that_asks_for_memory_goes_on_where_nobody_is_left_that_declares_it(engine, scheduler):
    scheduler.workers[A]["resources"] = {MEMORY: 2e9}
    with engine() as one:
        one.begin("peach", b"")
        happened(one)
        assert len(scheduler.given) == 1
        del scheduler.workers[A]
        happened(one)
        assert [fruit.options["resources"] for fruit in scheduler.given] == [{MEMORY: 104857600.0}, None]
        scheduler.given[1].end(DONE)
        assert happened(one) == [DONE]


def test_being_without_workers_is_said_again_and_again(engine, scheduler, said, monkeypatch):
    scheduler.workers.clear()
    now_s = [0.0]
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    with engine() as one:
        one.begin("peach", b"")
        for _ in range(12):
            now_s[0] += 60.0
            happened(one)
        scheduler.workers[A] = {"resources": {}}
        for _ in range(12):
            now_s[0] += 60.0
            happened(one)
    start = "dask worker tcp://there:8786 --nthreads 1"
    assert said[1:] == [
        f"waiting for workers ({start})",
        f"no worker for 6 min; 1 fruit wait ({start})",
        f"no worker for 12 min; 1 fruit wait ({start})",
    ]


@pytest.mark.parametrize(("most", "room"), [(None, 4), (3, 3), (1, 1)])
def test_two_fruit_for_each_worker_are_in_the_cluster_and_no_more_than_asked_for(engine, most, room):
    with engine(most=most) as one:
        assert one.room() == room


@pytest.mark.parametrize(("status", "words"), [(404, "it has no dashboard"), (200, "dashboard http://127")])
def test_a_dashboard_is_named_where_there_is_one(engine, scheduler, said, status, words):
    class Page(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Page) as pages:
        threading.Thread(target=pages.serve_forever, daemon=True).start()
        scheduler.link = f"http://127.0.0.1:{pages.server_port}/status"
        with engine():
            pages.shutdown()
    assert said[0].startswith(f"cluster at tcp://there:8786: 2 workers; {words}")

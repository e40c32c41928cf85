"""Engines and workers: what is not there is refused, an engine gets no more than it takes."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from cluster_work import needs_of
from distributed import KilledWorker

from pipeline.problem import BatchRefused
from pipeline.run import cluster, runner
from pipeline.run.cluster import Cluster
from pipeline.run.cluster_worker import FruitOrder, Unfit, fruit_here, unfit
from pipeline.run.runner import LocalPool
from pipeline.run.scheduling import Died, Finished, Progressed, WorkPlace, run_on

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


NOWHERE = Path("/nowhere/.run.json")


def refusal_of(needs, *, threads=1, most_MiB=None):
    return unfit(needs, threads=threads, most_MiB=most_MiB)


@pytest.mark.parametrize("most_MiB", [None, 100.0])
def test_one_that_is_as_this_machine_is_fit(tmp_path, most_MiB):
    assert refusal_of(needs_of(tmp_path), most_MiB=most_MiB) == ""


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
    assert sentence in refusal_of(needs_of(tmp_path, **changed))


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
    assert refusal_of(needs_of(tmp_path), **worker).startswith(sentence)


def test_results_that_cannot_be_written_to_are_named(tmp_path, monkeypatch):
    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pipeline.run.cluster_worker.tempfile.TemporaryFile", refused)
    assert "(Permission denied): OUT must lie" in refusal_of(needs_of(tmp_path))


def test_a_fruit_whose_process_cannot_be_made_ends_alike_here_and_on_a_worker(tmp_path, monkeypatch):
    def refused(*_):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(runner, "_started", refused)
    order = FruitOrder(fruit_id="a", packed=b"", time_limit_s=9.0, needs=needs_of(tmp_path))
    ended = Died("a", None, "its process did not start: Resource temporarily unavailable")
    assert fruit_here(order, tell=print, wanted=lambda: True, most_MiB=None) == ended
    assert list(run_on(LocalPool(jobs=1, time_limit_s=9.0), print, [("a", 1)])) == [ended]


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

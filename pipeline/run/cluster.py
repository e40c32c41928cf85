"""Many fruits on many machines: dask.distributed behind the border of pipeline.run.scheduling.

A fruit is a task; the worker that gets it works on it as a run on one machine would, in a process of its own
(pipeline.run.cluster_worker), so that time limits, crashes and results are the same. Files lie on a file
system that all machines share. dask.distributed is imported here, in pipeline.run.cluster_worker and, with
dask-jobqueue, in pipeline.run.slurm_jobs.
"""

import logging
import pickle
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Self

from distributed import Client, Future, KilledWorker, Security

from pipeline.batch.scratch import scratch
from pipeline.problem import BatchRefused, Problem, refused
from pipeline.run.cluster_worker import FruitOrder, RunNeeds, Unfit, fit_on_worker, packed_fruit
from pipeline.run.scheduling import Died, Event, Finished, Progressed
from pipeline.run.slurm_jobs import SlurmJobs, slurm_jobs

CONNECT_S = 20.0
"""Seconds in which a scheduler must answer. Set by hand: on a busy login node it takes a few."""
LOOK_S = 0.1
"""Seconds that are waited for news."""
COUNT_S = 1.0
"""Seconds after which workers are counted again."""
WITHOUT_S = 300.0
"""Seconds without a worker after which that is said, and said again. Set by hand: a worker starts within one
minute, a job of Slurm may wait for hours."""


class _Fruit(NamedTuple):
    """A fruit that the scheduler has; `workers`: the addresses that it may go to (None: any)."""

    order: FruitOrder
    future: Future
    workers: frozenset[str] | None


class Cluster:
    """Workers of dask.distributed: of a scheduler's `address`, or (None) of `workers` jobs of Slurm, which
    speak TLS with the run (`tls`) or plain TCP.

    Dask begins the fruit of a lost worker again on another one. A worker that is not fit gets no more fruit,
    and the run is refused where no other is there, or where the scheduler is lost. `most`: so many fruit in
    the cluster at most; `tell` gets sentences for staff.
    """

    def __init__(
        self,
        address: str | None,
        *,
        workers: int = 0,
        tls: bool = True,
        needs: RunNeeds,
        time_limit_s: float,
        tell: Callable[[str], None],
        most: int | None = None,
    ) -> None:
        self._asked, self._asked_workers, self._tls = address, workers, tls
        self._needs, self._time_limit_s, self._tell, self._most = needs, time_limit_s, tell, most
        self._held = ExitStack()
        self._slurm: SlurmJobs | None = None
        self._happened: SimpleQueue[tuple[str, Future | str]] = SimpleQueue()
        self._fruits: dict[str, _Fruit] = {}
        self._workers: set[str] = set()
        self._unfit: set[str] = set()
        self._counted_s = -float("inf")
        self._without_s = self._said_s = time.monotonic()
        self._topic = f"drupe-{uuid.uuid4().hex}"

    def __enter__(self) -> Self:
        """Finds the scheduler, or starts one and asks Slurm for workers; raises BatchRefused."""
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is said in our own words
        with ExitStack() as held:
            security = None
            self._address = self._asked or ""
            if self._asked is None:
                folder = held.enter_context(scratch(near=self._needs.run.parent)) if self._tls else None
                self._slurm = held.enter_context(
                    slurm_jobs(
                        self._asked_workers, self._needs.per_fruit_MiB, self._tell, certificates=folder
                    )
                )
                self._address = str(self._slurm.cluster.scheduler_address)
                security = self._slurm.cluster.security if self._tls else None
            self._client = self._connected(security)
            self._connection = self._client.scheduler_comm
            held.callback(self._disconnect)
            self._client.subscribe_topic(self._topic, lambda event: self._happened.put(event[1]))
            self._count()
            self._require_fit()
            dashboard = self._client.dashboard_link or "none"
            self._tell(f"cluster at {self._address}: {_counted(len(self._workers))}; dashboard {dashboard}")
            if not self._workers:
                self._tell(f"waiting for workers ({self._start()})")
            self._without_s = self._said_s = time.monotonic()
            self._held = held.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Takes back what is not done; workers then end the fruit's processes."""
        self._held.close()

    @property
    def at_once(self) -> int:
        """How many fruit are worked on at the same time, now; before there are workers, those asked for."""
        there = len(self._workers) or self._asked_workers or 1
        return there if self._most is None else min(there, self._most)

    def room(self) -> int:
        """How many more fruit it takes now."""
        self._look()
        return self.at_once - len(self._fruits)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Hands a fruit to the scheduler."""
        self._submit(
            FruitOrder(fruit_id=fruit_id, packed=packed, time_limit_s=self._time_limit_s, needs=self._needs)
        )

    def happened(self) -> Iterator[Event]:
        """Stages and endings since the last call."""
        self._look()
        with suppress(Empty):
            yield from self._events(*self._happened.get(timeout=LOOK_S))
            while True:
                yield from self._events(*self._happened.get_nowait())

    def _look(self) -> None:
        """Counts workers now and then; raises BatchRefused where the scheduler is lost: a client that comes
        back by itself does so without its fruit.
        """
        if self._client.status != "running" or self._client.scheduler_comm is not self._connection:
            sentence = "the scheduler is lost. drupe kept the finished fruit; run the same command again."
            raise refused(self._address, sentence)
        if time.monotonic() - self._counted_s > COUNT_S:
            self._count()
            self._move_on()
            if self._slurm is not None:
                self._slurm.look()

    def _events(self, fruit_id: str, news: Future | str) -> Iterator[Event]:
        if fruit_id not in self._fruits:
            return
        fruit = self._fruits[fruit_id]
        if isinstance(news, str):
            yield Progressed(fruit_id, news)
        elif news is fruit.future and (ending := self._ending(fruit)) is not None:
            del self._fruits[fruit_id]
            yield ending

    def _ending(self, fruit: _Fruit) -> Event | None:
        """How a fruit ended; None where it was begun again. Raises BatchRefused where no worker is fit, or
        the scheduler is lost.
        """
        order, future, _ = fruit
        try:
            ended = future.result(timeout=CONNECT_S)
        except KilledWorker as killed:
            lost, last = _counted(killed.allowed_failures + 1), killed.last_worker.address
            return Died(order.fruit_id, None, f"{lost} died with it, the last {last}")
        except (ImportError, AttributeError) as error:
            self._not_loaded(fruit, error)
            ended = None
        except Exception as error:  # noqa: BLE001 - dask's own, of which there are many kinds
            self._look()
            if future.status == "error":
                return Finished(order.fruit_id, error)
            ended = None  # it was lost on the way
        if isinstance(ended, Unfit):
            self._count()
            self._leave_out({ended.worker: ended.sentence})
            ended = None
        if ended is None:
            self._submit(order)
        return ended  # type: ignore[no-any-return]  # what `fruit_on_worker` returns

    def _not_loaded(self, fruit: _Fruit, error: Exception) -> None:
        """Leaves out the worker that could not load a fruit, which the error does not name; raises
        BatchRefused where every worker that the fruit may have gone to is fit.
        """
        self._look()
        self._count()
        self._require_fit()
        if not (self._unfit if fruit.workers is None else self._unfit & fruit.workers):
            raise refused(self._address, f"a worker {_cannot_load(error)}") from None

    def _submit(self, order: FruitOrder) -> None:
        """Gives a fruit to the scheduler, for workers that are fit while any of them is there."""
        workers = frozenset(self._workers) if self._unfit and self._workers else None
        future = self._client.submit(
            pickle.loads,
            packed_fruit(order, self._topic),
            key=f"fruit-{uuid.uuid4().hex}",
            pure=False,
            workers=None if workers is None else sorted(workers),
        )
        self._fruits[order.fruit_id] = _Fruit(order, future, workers)
        future.add_done_callback(lambda done: self._happened.put((order.fruit_id, done)))

    def _move_on(self) -> None:
        """Gives fruit to other workers that wait for some which are gone. `allow_other_workers` of dask would
        let one that is not fit take them from workers that are busy.
        """
        for order, future, workers in list(self._fruits.values()):
            waits = future.status == "pending" and workers is not None and workers.isdisjoint(self._workers)
            if waits and self._workers:
                self._submit(order)
                with suppress(Exception):
                    self._client.cancel([future], force=True)

    def _connected(self, security: Security | None) -> Client:
        try:
            return Client(
                self._address, timeout=CONNECT_S, set_as_default=False, name="drupe", security=security
            )
        except (OSError, ValueError) as error:
            why = f"no dask scheduler answers there ({str(error) or type(error).__name__})"
            sentence = f"{why}; start one with `dask scheduler`, and give the address that it prints."
            raise refused(self._address, sentence) from None

    def _disconnect(self) -> None:
        with suppress(Exception):
            self._client.cancel([fruit.future for fruit in self._fruits.values()], force=True)
        with suppress(Exception):
            self._client.close(timeout=CONNECT_S)

    def _count(self) -> None:
        """Asks the scheduler for its workers, and says now and then that there is none; where it does not
        answer, they stay those of before.
        """
        now_s = self._counted_s = time.monotonic()
        with suppress(Exception):  # no answer, or a client that is closed, which `_look` tells
            self._workers = set(self._client.scheduler_info(n_workers=-1)["workers"]) - self._unfit
        if self._workers:
            self._without_s = self._said_s = now_s
        elif now_s - self._said_s > WITHOUT_S:
            self._said_s = now_s
            minutes = (now_s - self._without_s) / 60
            self._tell(f"no worker for {minutes:.0f} min; {len(self._fruits)} fruit wait ({self._start()})")

    def _leave_out(self, sentences: dict[str, str]) -> None:
        """Gives no more fruit to workers that are not fit, by address, and says so; raises BatchRefused where
        no other is there.
        """
        newly_unfit = {address: why for address, why in sentences.items() if address not in self._unfit}
        self._unfit |= set(newly_unfit)
        self._workers -= self._unfit
        if sentences and not self._workers:
            raise BatchRefused(_problems(sentences))
        for problem in _problems(newly_unfit):
            self._tell(f"left out: {problem}")

    def _start(self) -> str:
        if self._slurm is None:
            return f"dask worker {self._address} --nthreads 1"
        return f"Slurm: {self._slurm.refusal}" if self._slurm.refusal else "Slurm; `squeue` shows its jobs"

    def _require_fit(self) -> None:
        """Asks the workers that are there whether they are fit; one that comes later is asked when it gets
        its first fruit, or cannot load it. Raises BatchRefused with what is wrong where none is.
        """
        answers = self._client.run(fit_on_worker, self._needs, on_error="return")
        said = {address: _sentence(answer) for address, answer in answers.items()}
        self._leave_out({address: why for address, why in said.items() if why})


def _sentence(answer: Any) -> str:
    """A worker's answer to `fit_on_worker`; empty where it went away meanwhile."""
    if isinstance(answer, str):
        return answer
    return "" if isinstance(answer, OSError) else _cannot_load(answer)


def _problems(sentences: dict[str, str]) -> list[Problem]:
    """What is wrong with workers, those of one sentence together."""
    said: dict[str, list[str]] = {}
    for address, why in sentences.items():
        said.setdefault(why, []).append(address)
    return [
        Problem(f"worker {where[0]}" if len(where) == 1 else f"{len(where)} workers ({where[0]}, ...)", why)
        for why, where in said.items()
    ]


def _cannot_load(error: Any) -> str:
    """A worker's answer to being asked for what it does not have."""
    return (
        f"cannot load this drupe ({type(error).__name__}: {error}); install the same drupe on both, with the "
        "extra cluster."
    )


def _counted(workers: int) -> str:
    return f"{workers} worker{'' if workers == 1 else 's'}"

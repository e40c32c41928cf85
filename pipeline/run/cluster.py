"""Many fruits on many machines: dask.distributed behind the border of pipeline.run.scheduling.

A fruit is a task; the worker that gets it works on it as a run on one machine would, in a process of its own
(pipeline.run.cluster_worker), so that time limits, crashes and results are the same. Files lie on a file
system that all machines share. dask.distributed is imported here, in
pipeline.run.worker_tasks and, with dask-jobqueue, in pipeline.run.slurm_jobs.
"""

import logging
import pickle
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPException
from queue import Empty, SimpleQueue
from typing import Any, Self
from urllib.error import HTTPError
from urllib.request import ProxyHandler, build_opener

from distributed import Client, Future, KilledWorker, Security

from pipeline.batch.scratch import scratch
from pipeline.problem import BatchRefused, Problem, refused
from pipeline.run.cluster_worker import FruitOrder, RunNeeds, Unfit
from pipeline.run.scheduling import Died, Event, Finished, Progressed
from pipeline.run.slurm_jobs import MEMORY, SlurmJobs, slurm_jobs
from pipeline.run.worker_tasks import BEGUN, fit_on_worker, packed_fruit

CONNECT_S = 20.0
"""Seconds in which a scheduler must answer. Set by hand: on a busy login node it takes a few."""
BACK_S = 600.0
"""Seconds in which a scheduler that went away must be back. Set by hand: a machine has rebooted by then."""
LOOK_S = 0.1
"""Seconds that are waited for news."""
COUNT_S = 1.0
"""Seconds after which workers are counted again."""
WITHOUT_S = 300.0
"""Seconds without a worker after which that is said, and said again. Set by hand: a worker starts within one
minute, a job of Slurm may wait for hours."""
AHEAD = 2
"""Fruit in the cluster for each worker: one that is worked on, one that waits, so that no worker waits for
this process. More would only fill the scheduler's memory."""
LOADS = 3
"""Times that no worker could load a fruit after which the run is refused. Set by hand: each finds a worker
that is left out, or no cause."""


@dataclass(frozen=True, kw_only=True)
class ClusterPlace:
    """A running scheduler's address, or None: Slurm is asked for `workers` jobs of one worker each, which
    speak TLS with the run (`tls`) or plain TCP.
    """

    address: str | None
    workers: int = 0
    tls: bool = True


@dataclass
class _Fruit:
    """A fruit that the scheduler has, or gets as soon as it is there.

    `workers`: the addresses it may go to (None: any); `memory`: whether it asks for the resource; `begun`:
    how often a worker began with it; `given_up`: how often dask gave it up, or a worker could not load it.
    """

    order: FruitOrder
    future: Future | None = None
    workers: frozenset[str] | None = None
    memory: bool = False
    begun: int = 0
    given_up: int = 0


class Cluster:
    """Workers of dask.distributed.

    One that is lost with a fruit, or a scheduler that is killed and comes back at its address, costs nothing
    but time: the fruit is begun again. A worker that is not fit gets no more fruit, and the run is refused
    where no other is there. `most`: so many fruit in the cluster at most, none of which then waits for a
    worker; `tell` gets sentences for staff.
    """

    def __init__(
        self,
        place: ClusterPlace,
        *,
        needs: RunNeeds,
        time_limit_s: float,
        tell: Callable[[str], None],
        most: int | None = None,
    ) -> None:
        self._place, self._needs, self._time_limit_s = place, needs, time_limit_s
        self._tell, self._most = tell, most
        self._held = ExitStack()
        self._slurm: SlurmJobs | None = None
        self._security: Security | None = None
        self._happened: SimpleQueue[tuple[str, Future | str]] = SimpleQueue()
        self._fruits: dict[str, _Fruit] = {}
        self._workers: dict[str, Any] = {}
        self._unfit: set[str] = set()
        self._counted_s = -float("inf")
        self._without_s = self._said_s = time.monotonic()
        self._topic = f"drupe-{uuid.uuid4().hex}"

    def __enter__(self) -> Self:
        """Finds the scheduler, or starts one and asks Slurm for workers; raises BatchRefused."""
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is said in our own words
        with ExitStack() as held:
            if self._place.address is None:
                folder = held.enter_context(scratch(near=self._needs.run.parent)) if self._place.tls else None
                jobs = slurm_jobs(
                    self._place.workers, self._needs.per_fruit_MiB, self._tell, certificates=folder
                )
                self._slurm = held.enter_context(jobs)
                self._address = str(self._slurm.cluster.scheduler_address)
                self._security = self._slurm.cluster.security if self._place.tls else None
            else:
                self._address = self._place.address
            self._connect()
            held.callback(self._disconnect)
            self._count()
            self._require_fit()
            self._tell(f"cluster at {self._address}: {_counted(len(self._workers))}; {self._dashboard()}")
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
        there = len(self._workers) or self._place.workers or 1
        return there if self._most is None else min(there, self._most)

    def room(self) -> int:
        """How many more fruit it takes now."""
        self._look()
        ahead = AHEAD * self.at_once
        return (ahead if self._most is None else min(ahead, self._most)) - len(self._fruits)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Hands a fruit to the scheduler."""
        self._look()
        order = FruitOrder(
            fruit_id=fruit_id, packed=packed, time_limit_s=self._time_limit_s, needs=self._needs
        )
        self._fruits[fruit_id] = _Fruit(order)
        self._submit(self._fruits[fruit_id])

    def happened(self) -> Iterator[Event]:
        """Stages and endings since the last call."""
        self._look()
        with suppress(Empty):
            yield from self._events(*self._happened.get(timeout=LOOK_S))
            while True:
                yield from self._events(*self._happened.get_nowait())

    def _look(self) -> None:
        """Joins the scheduler again where it was lost; counts workers, and goes by that, now and then."""
        if not self._joined():
            self._rejoin()
        if time.monotonic() - self._counted_s > COUNT_S:
            self._count()
            self._move_on()
            self._say_without()
            if self._slurm is not None:
                self._slurm.look()

    def _joined(self) -> bool:
        """Whether the scheduler has what it was given. A client that lost it comes back by itself within
        CONNECT_S, on another connection, without its fruit and without news of their stages.
        """
        return self._client.status == "running" and self._client.scheduler_comm is self._connection

    def _events(self, fruit_id: str, news: Future | str) -> Iterator[Event]:
        fruit = self._fruits.get(fruit_id)
        if fruit is None:
            return
        if news == BEGUN:
            fruit.begun += 1
        elif isinstance(news, str):
            yield Progressed(fruit_id, news)
        elif news is fruit.future and (ending := self._ending(fruit_id, fruit, news)) is not None:
            del self._fruits[fruit_id]
            yield ending

    def _ending(self, fruit_id: str, fruit: _Fruit, future: Future) -> Event | None:
        """How a fruit ended; None where it was begun again, or will be. Raises BatchRefused where no worker
        is fit.
        """
        try:
            ended = future.result(timeout=CONNECT_S)
        except KilledWorker as killed:
            fruit.given_up += 1
            if max(fruit.begun, fruit.given_up) > killed.allowed_failures:
                lost = max(fruit.begun, killed.allowed_failures + 1)
                return Died(
                    fruit_id, None, f"{_counted(lost)} died with it, the last {killed.last_worker.address}"
                )
            ended = None  # dask also blames those that only waited for a worker that was lost
        except Exception as error:  # noqa: BLE001 - dask's own, of which there are many kinds
            if not (self._joined() and future.status == "error"):
                ended = None
            elif isinstance(error, (ImportError, AttributeError)):
                self._not_loaded(fruit, error)
                ended = None
            else:
                return Finished(fruit_id, error)
        if isinstance(ended, Unfit):
            self._count()
            self._leave_out({ended.worker: ended.sentence})
            ended = None
        if ended is None:
            self._submit(fruit)
        return ended  # type: ignore[no-any-return]  # what `fruit_on_worker` returns

    def _not_loaded(self, fruit: _Fruit, error: Exception) -> None:
        """Finds the worker that could not load a fruit, which the error does not name."""
        fruit.given_up += 1
        self._count()
        self._require_fit()
        if fruit.given_up > LOADS or not self._unfit:
            raise refused(self._address, f"a worker {_cannot_load(error)}")

    def _submit(self, fruit: _Fruit) -> None:
        """Gives a fruit to the scheduler, for workers that are fit; where that is gone, `_rejoin` does."""
        fruit.workers = frozenset(self._workers) if self._unfit and self._workers else None
        declared = any(MEMORY in worker["resources"] for worker in self._workers.values())
        fruit.memory = declared or (self._slurm is not None and not self._workers)
        try:
            future = self._client.submit(
                pickle.loads,
                packed_fruit(fruit.order, self._topic),
                key=f"fruit-{uuid.uuid4().hex}",
                pure=False,
                workers=None if fruit.workers is None else sorted(fruit.workers),
                resources={MEMORY: self._needs.per_fruit_MiB * 2**20} if fruit.memory else None,
            )
            future.add_done_callback(lambda done: self._happened.put((fruit.order.fruit_id, done)))
            fruit.future = future
        except OSError:
            return
        except Exception:
            if self._joined():
                raise

    def _move_on(self) -> None:
        """Gives fruit to other workers that wait for some which are gone."""
        for fruit in self._fruits.values():
            takers = (address for address in self._workers if self._may_go(fruit, address))
            if self._workers and (fruit.future is None or next(takers, None) is None):
                stuck = fruit.future
                self._submit(fruit)
                with suppress(Exception):
                    self._client.cancel([stuck], force=True)

    def _may_go(self, fruit: _Fruit, address: str) -> bool:
        """Whether dask gives the fruit to a worker."""
        allowed = fruit.workers is None or address in fruit.workers
        return allowed and (not fruit.memory or MEMORY in self._workers[address]["resources"])

    def _connect(self) -> None:
        try:
            self._client = Client(
                self._address, timeout=CONNECT_S, set_as_default=False, name="drupe", security=self._security
            )
        except (OSError, ValueError) as error:
            why = f"no dask scheduler answers there ({str(error) or type(error).__name__})"
            sentence = f"{why}; start one with `dask scheduler`, and give the address that it prints."
            raise refused(self._address, sentence) from None
        self._connection = self._client.scheduler_comm
        with suppress(Exception):  # it is gone again, which `_joined` tells
            self._client.subscribe_topic(self._topic, self._stage_begun)

    def _stage_begun(self, event: tuple[float, Any]) -> None:
        """A worker's news of a stage, on the client's own thread."""
        fruit_id, stage = event[1]
        self._happened.put((fruit_id, stage))

    def _disconnect(self) -> None:
        with suppress(Exception):
            futures = [fruit.future for fruit in self._fruits.values() if fruit.future is not None]
            self._client.cancel(futures, force=True)
        with suppress(Exception):
            self._client.close(timeout=CONNECT_S)

    def _rejoin(self) -> None:
        """Waits for a scheduler that is gone, and hands it every fruit that has not ended."""
        self._tell(
            f"the scheduler at {self._address} does not answer; {len(self._fruits)} fruit wait for it "
            f"(at most {BACK_S / 60:.0f} min)"
        )
        end_s = time.monotonic() + BACK_S
        while True:
            with suppress(Exception):
                self._client.close(timeout=COUNT_S)  # there is nobody to take fruit back from
            try:
                self._connect()
                break
            except BatchRefused:
                if self._place.address is None or time.monotonic() > end_s:
                    sentence = (
                        "the scheduler stopped. drupe kept the finished fruit; run the same "
                        "command again to continue."
                    )
                    raise refused(self._address, sentence) from None
                time.sleep(LOOK_S)
        self._unfit.clear()  # a worker that was started again may have the same address
        self._count()
        self._tell(f"the scheduler answers again, with {_counted(len(self._workers))}")
        for fruit in self._fruits.values():
            fruit.future = None
            self._submit(fruit)

    def _count(self) -> None:
        """Asks the scheduler for its workers; where it does not answer, they stay those of before. Raises
        BatchRefused where none declares memory enough.
        """
        self._counted_s = time.monotonic()
        with suppress(Exception):  # no answer, or a client that is closed, which `_joined` tells
            there = self._client.scheduler_info(n_workers=-1)["workers"]
            self._workers = {address: one for address, one in there.items() if address not in self._unfit}
        need = self._needs.per_fruit_MiB * 2**20
        self._leave_out(
            {
                address: f"declares {MEMORY}={declared:.0f} (bytes), but one fruit needs {need:.0f}."
                for address, worker in self._workers.items()
                if (declared := worker["resources"].get(MEMORY, need)) < need
            }
        )

    def _leave_out(self, sentences: dict[str, str]) -> None:
        """Gives no more fruit to workers that are not fit, by address, and says so; raises BatchRefused where
        no other is there.
        """
        found = {address: why for address, why in sentences.items() if address not in self._unfit}
        self._unfit |= set(found)
        for address in sentences:
            self._workers.pop(address, None)
        if sentences and not self._workers:
            raise BatchRefused(_problems(sentences))
        for problem in _problems(found):
            self._tell(f"left out: {problem}")

    def _say_without(self) -> None:
        """Says now and then that there is no worker."""
        now_s = time.monotonic()
        if self._workers:
            self._without_s = self._said_s = now_s
        elif now_s - self._said_s > WITHOUT_S:
            self._said_s = now_s
            minutes = (now_s - self._without_s) / 60
            self._tell(f"no worker for {minutes:.0f} min; {len(self._fruits)} fruit wait ({self._start()})")

    def _start(self) -> str:
        if self._slurm is None:
            return f"dask worker {self._address} --nthreads 1"
        return f"Slurm: {self._slurm.refusal}" if self._slurm.refusal else "Slurm; `squeue` shows its jobs"

    def _dashboard(self) -> str:
        """Where its dashboard is: without bokeh a page that says what to install; --no-dashboard, none."""
        link = self._client.dashboard_link or ""
        try:
            build_opener(ProxyHandler({})).open(link, timeout=CONNECT_S).close()
        except HTTPError as error:
            if error.code == HTTPStatus.NOT_FOUND:
                return "it has no dashboard"
        except (OSError, ValueError, HTTPException):
            pass  # it can be there for others
        return f"dashboard {link}" if link else "it has no dashboard"

    def _require_fit(self) -> None:
        """Asks the workers that are there whether they are fit; one that comes later is asked when it gets
        its first fruit. Raises BatchRefused with what is wrong where none is.
        """
        answers = {}
        with suppress(Exception):  # of a client that is closed, which `_joined` tells
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

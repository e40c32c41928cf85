"""Many fruits on many machines: dask.distributed behind the border of pipeline.run.scheduling.

A fruit is a task; the worker that gets it works on it as a run on one machine would, in a process of its own
(pipeline.run.cluster_worker), so that time limits, crashes and results are the same. Files lie on a file
system that all machines share. dask.distributed and dask-jobqueue are imported here alone.
"""

import logging
import shutil
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Self

import dask
from distributed import Client, Future, KilledWorker, get_worker
from distributed.core import Status

from pipeline.problem import BatchRefused, Problem
from pipeline.run.cluster_worker import FruitOrder, RunNeeds, Unfit, fruit_here, unfit
from pipeline.run.scheduling import Died, Event, Finished, Progressed

CONNECT_S = 20.0
"""Seconds in which a scheduler must answer. Set by hand: on a busy login node it takes a few."""
BACK_S = 600.0
"""Seconds in which a scheduler that went away must be back. Set by hand: a machine has rebooted by then."""
LOOK_S = 0.1
"""Seconds that are waited for news."""
COUNT_S = 1.0
"""Seconds after which workers are counted again."""
AHEAD = 2
"""Fruit in the cluster for each worker: one that is worked on, one that waits, so that no worker waits for
this process. More would only fill the scheduler's memory."""
OWN_MIB = 500.0
"""What a worker and its nanny take beside the fruit's process: 140 MiB measured of a worker
(benchmarks/cluster_speed.py), as much for its nanny, and as much again for what grows."""
FAILURES = 3
"""Workers that may be lost with a fruit before it is given up, where this process starts the scheduler;
dask's own default, which applies elsewhere (`distributed.scheduler.allowed-failures`)."""
MEMORY = "MEMORY"
"""The resource (bytes) that a fruit asks for where workers declare it; the name of dask's own manual."""


BEGUN = ""
"""In the place of a stage: a worker begins with a fruit, for the first time or again."""
WORKING = (Status.running, Status.paused, Status.closing_gracefully)
"""A worker's states in which it goes on with its fruit."""


@dataclass(frozen=True, kw_only=True)
class ClusterPlace:
    """A running scheduler's address, or None: Slurm is asked for `workers` jobs of one worker each."""

    address: str | None
    workers: int = 0


class Cluster:
    """Workers of dask.distributed.

    One that is lost with a fruit, or a scheduler that is killed and comes back at its address, costs nothing
    but time: the fruit is begun again. `most`: so many fruit at once at most; `tell` gets sentences for
    staff.
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
        self._happened: SimpleQueue[tuple[str, Future | str]] = SimpleQueue()
        self._orders: dict[str, FruitOrder] = {}
        self._futures: dict[str, Future] = {}
        self._tries: dict[str, int] = {}
        self._workers: dict[str, Any] = {}
        self._counted_s = -float("inf")
        self._topic = f"drupe-{uuid.uuid4().hex}"

    def __enter__(self) -> Self:
        """Finds the scheduler, or starts one and asks Slurm for workers; raises BatchRefused."""
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is said in our own words
        with ExitStack() as held:
            if self._place.address is None:
                cluster = held.enter_context(_slurm(self._place.workers, self._needs.per_fruit_MiB))
                self._address = str(cluster.scheduler_address)
            else:
                self._address = self._place.address
            self._connect()
            held.callback(self._disconnect)
            self._count()
            self._require_fit()
            self._tell(f"cluster at {self._address}: {_counted(len(self._workers))}; {self._dashboard()}")
            if not self._workers:
                start = (
                    "Slurm" if self._place.address is None else f"dask worker {self._address} --nthreads 1"
                )
                self._tell(f"waiting for workers ({start})")
            self._held = held.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Takes back what is not done; workers then end the fruit's processes."""
        self._held.close()

    @property
    def at_once(self) -> int:
        """How many fruit are worked on at the same time, now; before there are workers, those asked for."""
        there = len(self._workers) or self._place.workers or 1
        return there if self._most is None else min(there, self._most)

    def room(self) -> int:
        """How many more fruit it takes now."""
        if time.monotonic() - self._counted_s > COUNT_S:
            self._count()
        most = AHEAD * self.at_once if self._most is None else min(AHEAD * self.at_once, self._most)
        return most - len(self._orders)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Hands a fruit to the scheduler."""
        order = FruitOrder(
            fruit_id=fruit_id, packed=packed, time_limit_s=self._time_limit_s, needs=self._needs
        )
        self._orders[fruit_id], self._tries[fruit_id] = order, 0
        with suppress(OSError):  # the scheduler is gone, which `happened` finds
            self._submit(order)

    def happened(self) -> Iterator[Event]:
        """Stages and endings since the last call."""
        if self._client.status != "running":
            self._rejoin()
        with suppress(Empty):
            yield from self._events(*self._happened.get(timeout=LOOK_S))
            while True:
                yield from self._events(*self._happened.get_nowait())

    def _events(self, fruit_id: str, news: Future | str) -> Iterator[Event]:
        if fruit_id not in self._orders:
            return
        if news == BEGUN:
            self._tries[fruit_id] += 1
        elif isinstance(news, str):
            yield Progressed(fruit_id, news)
        elif news is self._futures.get(fruit_id) and (ending := self._ending(fruit_id, news)) is not None:
            del self._orders[fruit_id], self._futures[fruit_id], self._tries[fruit_id]
            yield ending

    def _ending(self, fruit_id: str, future: Future) -> Event | None:
        """How a fruit ended; None where it was begun again, or will be. Raises BatchRefused for a worker that
        is not fit.
        """
        try:
            ended = future.result(timeout=CONNECT_S)
        except KilledWorker as killed:
            tries = self._tries[fruit_id]
            if tries > killed.allowed_failures:
                how = f"{_counted(tries)} lost with it, the last {killed.last_worker.address}"
                return Died(fruit_id, None, how)
            ended = None  # dask also blames those that only waited for a worker that was lost
        except (ImportError, AttributeError) as error:
            raise _refused(self._address, f"a worker {_cannot_load(error)}") from None
        except Exception as error:  # noqa: BLE001 - dask's own, of which there are many kinds
            if self._client.status == "running" and future.status == "error":
                return Finished(fruit_id, error)
            ended = None
        if isinstance(ended, Unfit):
            raise _refused(self._address, f"a worker {ended.sentence}")
        if ended is None:
            self._again(fruit_id)
            return None
        return ended  # type: ignore[no-any-return]  # what `_on_worker` returns

    def _again(self, fruit_id: str) -> None:
        """Begins a fruit again whose result was lost on its way; with the scheduler gone, `_rejoin` does."""
        if self._client.status == "running":
            with suppress(OSError):
                self._submit(self._orders[fruit_id])

    def _submit(self, order: FruitOrder) -> None:
        future = self._client.submit(
            _on_worker,
            order,
            self._topic,
            key=f"fruit-{uuid.uuid4().hex}",
            pure=False,
            resources=self._resources(),
        )
        self._futures[order.fruit_id] = future
        future.add_done_callback(lambda done: self._happened.put((order.fruit_id, done)))

    def _resources(self) -> dict[str, float] | None:
        """Memory, where workers declare it."""
        declared = any(MEMORY in worker["resources"] for worker in self._workers.values())
        return {MEMORY: self._needs.per_fruit_MiB * 2**20} if declared or not self._place.address else None

    def _connect(self) -> None:
        """Raises BatchRefused where no scheduler answers."""
        try:
            self._client = Client(self._address, timeout=CONNECT_S, set_as_default=False, name="drupe")
        except (OSError, ValueError) as error:
            why = f"no scheduler of dask answers there ({str(error) or type(error).__name__})"
            sentence = f"{why}; start one with `dask scheduler`, and name the address that it prints."
            raise _refused(self._address, sentence) from None
        self._client.subscribe_topic(self._topic, self._stage_begun)

    def _stage_begun(self, event: tuple[float, Any]) -> None:
        """A worker's news of a stage, on the client's own thread."""
        fruit_id, stage = event[1]
        self._happened.put((fruit_id, stage))

    def _disconnect(self) -> None:
        with suppress(Exception):
            self._client.cancel(list(self._futures.values()), force=True)
        with suppress(Exception):
            self._client.close(timeout=CONNECT_S)

    def _rejoin(self) -> None:
        """Waits for a scheduler that is gone, and hands it every fruit that has not ended."""
        self._tell(
            f"the scheduler at {self._address} is gone; {len(self._orders)} fruit wait for it to come back "
            f"(until {BACK_S / 60:.0f} min have passed)"
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
                    sentence = "the scheduler went away; finished fruit are kept, the same command goes on."
                    raise _refused(self._address, sentence) from None
                time.sleep(LOOK_S)
        self._futures.clear()
        self._count()
        self._tell(f"the scheduler is back, with {_counted(len(self._workers))}")
        for order in self._orders.values():
            with suppress(OSError):
                self._submit(order)

    def _count(self) -> None:
        """Asks the scheduler for its workers; where it does not answer, they stay those of before."""
        with suppress(OSError):
            self._workers = dict(self._client.scheduler_info(n_workers=-1)["workers"])
        self._counted_s = time.monotonic()

    def _dashboard(self) -> str:
        """Where its dashboard is; one without bokeh has none."""
        served = "dashboard" in self._client.scheduler_info(n_workers=0)["services"]
        return f"dashboard {self._client.dashboard_link}" if served else "it has no dashboard"

    def _require_fit(self) -> None:
        """Raises BatchRefused with what is wrong with the workers that are there; one that comes later is
        asked when it gets its first fruit.
        """
        said: dict[str, list[str]] = {}
        with suppress(OSError):
            answers = self._client.run(_fit, self._needs, on_error="return")
            for address, answer in answers.items():
                why = answer if isinstance(answer, str) else _cannot_load(answer)
                if why:
                    said.setdefault(why, []).append(address)
        declared = [w["resources"][MEMORY] for w in self._workers.values() if MEMORY in w["resources"]]
        if declared and max(declared) < self._needs.per_fruit_MiB * 2**20:
            need = f"{self._needs.per_fruit_MiB * 2**20:.0f}"
            said[f"declares {MEMORY}={max(declared):.0f} (bytes), and one fruit needs {need}."] = [
                str(next(iter(self._workers)))
            ]
        if said:
            raise BatchRefused(
                Problem(
                    f"worker {where[0]}" if len(where) == 1 else f"{len(where)} workers ({where[0]}, ...)",
                    why,
                )
                for why, where in said.items()
            )


def _on_worker(order: FruitOrder, topic: str) -> Event | Unfit | None:
    """On a worker: one fruit, whose stages go to the run that asked for it."""
    worker = get_worker()
    key = worker.get_current_task()
    most_MiB = _most_MiB(worker)
    if why := unfit(order.needs, threads=worker.state.nthreads, most_MiB=most_MiB):
        return Unfit(f"({worker.address}) {why}")

    def wanted() -> bool:
        """Until the run takes the fruit back or is gone, or the worker has lost its scheduler."""
        task = worker.state.tasks.get(key)
        return worker.status in WORKING and task is not None and task.state == "executing"

    def tell(stage: str) -> None:
        worker.log_event(topic, (order.fruit_id, stage))

    tell(BEGUN)
    return fruit_here(order, tell=tell, wanted=wanted, most_MiB=most_MiB)


def _fit(needs: RunNeeds, dask_worker: Any) -> str:
    """On a worker: why it cannot work for the run."""
    return unfit(needs, threads=dask_worker.state.nthreads, most_MiB=_most_MiB(dask_worker))


def _most_MiB(worker: Any) -> float | None:
    """Memory that a worker may use; None: it has no limit."""
    limit = worker.memory_manager.memory_limit
    return limit / 2**20 if limit else None


def _cannot_load(error: Any) -> str:
    """A worker's answer to being asked for what it does not have."""
    return (
        f"cannot load this drupe ({type(error).__name__}: {error}); install the same drupe on both, with the "
        "extra cluster."
    )


def _counted(workers: int) -> str:
    return f"{workers} worker{'' if workers == 1 else 's'}"


def _refused(place: str, sentence: str) -> BatchRefused:
    return BatchRefused([Problem(place, sentence)])


def _slurm(workers: int, per_fruit_MiB: float) -> Any:
    """A scheduler in this process and `workers` jobs of Slurm, replaced as they end; queue, account and time
    are those of dask-jobqueue's own settings (~/.config/dask/jobqueue.yaml). Raises BatchRefused.
    """
    if shutil.which("sbatch") is None:
        raise _refused("--slurm", "found no sbatch; run this where jobs are submitted, or use --scheduler.")
    from dask_jobqueue import SLURMCluster

    dask.config.set({"distributed.scheduler.allowed-failures": FAILURES})
    memory_MiB = per_fruit_MiB + OWN_MIB
    try:
        cluster = SLURMCluster(
            cores=1,
            processes=1,
            memory=f"{memory_MiB:.0f} MiB",
            job_name="drupe",
            python=sys.executable,
            job_script_prologue=["export PYTHONSAFEPATH=1"],
            worker_extra_args=["--resources", f"{MEMORY}={memory_MiB * 2**20:.0f}"],
        )
    except (OSError, ValueError, RuntimeError) as error:
        raise _refused("--slurm", f"Slurm cannot be used ({error}).") from None
    cluster.adapt(minimum=workers, maximum=workers)
    return cluster

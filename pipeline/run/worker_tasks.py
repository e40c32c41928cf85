"""What a worker of dask.distributed is asked to do: to say whether it is fit, and to work on a fruit."""

import pickle
from dataclasses import dataclass, replace
from typing import Any

from distributed import get_worker
from distributed.core import Status

from pipeline.run.cluster_worker import OWN_MIB, FruitOrder, RunNeeds, Unfit, fruit_here, unfit
from pipeline.run.scheduling import Event

BEGUN = ""
"""In the place of a stage: a worker begins with a fruit, for the first time or again."""
WORKING = (Status.running, Status.paused, Status.closing_gracefully)
"""A worker's states in which it goes on with its fruit."""


@dataclass(frozen=True)
class _Call:
    """A fruit that is begun where this is unpickled."""

    order: FruitOrder
    topic: str

    def __reduce__(self) -> tuple:
        return fruit_on_worker, (self.order, self.topic)


def packed_fruit(order: FruitOrder, topic: str) -> bytes:
    """A fruit for a worker, whose task is `pickle.loads`: every worker has that, and one that cannot load
    drupe fails in the task. What dask itself cannot unpickle ends the worker without a word.
    """
    return pickle.dumps(_Call(order, topic))


def fruit_on_worker(order: FruitOrder, topic: str) -> Event | Unfit | None:
    """On a worker: one fruit, whose stages go to the run that asked for it."""
    worker = get_worker()
    key = worker.get_current_task()
    most_MiB = _most_MiB(worker)
    if why := unfit(order.needs, threads=worker.state.nthreads, most_MiB=most_MiB):
        return Unfit(why, worker.address)

    def wanted() -> bool:
        """Until the run takes the fruit back or is gone, or the worker has lost its scheduler."""
        task = worker.state.tasks.get(key)
        return worker.status in WORKING and task is not None and task.state == "executing"

    def tell(stage: str) -> None:
        worker.log_event(topic, (order.fruit_id, stage))

    tell(BEGUN)
    ended = fruit_here(order, tell=tell, wanted=wanted, most_MiB=most_MiB)
    return replace(ended, worker=worker.address) if isinstance(ended, Unfit) else ended


def fit_on_worker(needs: RunNeeds, dask_worker: Any) -> str:
    """On a worker: why it cannot work for the run; empty where it can."""
    return unfit(needs, threads=dask_worker.state.nthreads, most_MiB=_most_MiB(dask_worker))


def _most_MiB(worker: Any) -> float | None:
    """Memory that a worker leaves to a fruit's process, lest both are killed; None: it has no limit."""
    limit = worker.memory_manager.memory_limit
    return max(0.0, limit / 2**20 - OWN_MIB) if limit else None

"""The work of one worker of a cluster: it checks that it meets the run's needs, and grades one fruit."""

import multiprocessing
import pickle
import platform
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from distributed import get_worker
from distributed.core import Status

from pipeline.batch.cache import ROOMS, code_version
from pipeline.batch.provenance import is_marked
from pipeline.problem import BatchRefused
from pipeline.run.runner import LocalPool
from pipeline.run.scheduling import Event, Noted, Progressed, not_begun

OWN_MIB = 500.0
"""Memory of a worker and its nanny beside the fruit's process. A worker was measured at 140 MiB; the nanny
takes as much, and growth as much again."""
WORKING = (Status.running, Status.paused, Status.closing_gracefully)
"""States in which a worker continues with its fruit."""


@dataclass(frozen=True, kw_only=True)
class RunNeeds:
    """What a run needs of its workers: the same drupe, its batch and results at the same paths, memory.

    `drupe`: `this_drupe`; `mark`: the run's mark in the file `run`.
    """

    drupe: str
    settings: Path
    run: Path
    mark: str
    per_fruit_MiB: float


@dataclass(frozen=True, kw_only=True)
class FruitOrder:
    """One fruit for a worker; `packed` as in pipeline.run.scheduling.Engine."""

    fruit_id: str
    packed: bytes
    time_limit_s: float
    needs: RunNeeds


@dataclass(frozen=True)
class Unfit:
    """Why a worker (its address) cannot work for the run."""

    sentence: str
    worker: str


@cache
def this_drupe() -> str:
    """Versions of drupe, its code with libraries, and Python; pickles of one version fit no other."""
    python = ".".join(platform.python_version_tuple()[:2])
    return f"drupe {metadata.version('drupe')} (code {code_version(ROOMS)[:12]}) on Python {python}"


def unfit(needs: RunNeeds, *, threads: int, most_MiB: float | None) -> str:
    """Why a worker cannot work for the run, as a sentence; empty if it can. `most_MiB`: the memory that it
    leaves to a fruit (None: no limit).
    """
    if threads != 1:
        return f"has {threads} threads, expected 1 (one fruit at a time); start it with --nthreads 1."
    if most_MiB is not None and most_MiB < needs.per_fruit_MiB:
        return (
            f"has {most_MiB:.0f} MiB of memory per fruit, but a fruit needs about "
            f"{needs.per_fruit_MiB:.0f} MiB. Start it with --memory-limit "
            f"{needs.per_fruit_MiB + OWN_MIB:.0f}MiB or more, or start fewer workers on the machine."
        )
    if this_drupe() != needs.drupe:
        return (
            f"runs {this_drupe()}, but this command runs {needs.drupe}. Install the same on both; best is "
            "one environment on the shared file system."
        )
    if not needs.settings.is_file():
        return f"does not find {needs.settings}: BATCH must lie on a file system that all machines share."
    shared = "OUT must lie on a file system that all machines share and can write to."
    if not is_marked(needs.run, needs.mark):
        return f"does not see {needs.run.parent} as this command does: {shared}"
    try:
        with tempfile.TemporaryFile(dir=needs.run.parent):
            return ""
    except OSError as error:
        return f"cannot write into {needs.run.parent} ({error.strerror}): {shared}"


def fruit_here(
    order: FruitOrder, *, tell: Callable[[str], None], wanted: Callable[[], bool], most_MiB: float | None
) -> Event | None:
    """Grades one fruit in a process of its own, as a run on this machine would; returns how it ended.

    `tell` gets its stages, the worker's log what libraries write. If the fruit is no longer `wanted`, stops
    it and returns None. `most_MiB`: the memory limit of the fruit's process. Raises BatchRefused if no
    temporary folder can be made.
    """
    # A nanny starts its worker as a daemon of multiprocessing. Daemons must not start processes, which
    # may outlive them. A fruit's process does not: it ends with its parent (pipeline.run.runner).
    multiprocessing.current_process().daemon = False
    with LocalPool(jobs=1, time_limit_s=order.time_limit_s, most_MiB=most_MiB) as pool:
        try:
            pool.begin(order.fruit_id, order.packed)
        except OSError as error:
            return not_begun(order.fruit_id, error)
        while wanted():
            for event in pool.happened():
                if isinstance(event, Noted):
                    sys.stderr.write(f"{event.fruit_id}: {event.line}\n")
                elif isinstance(event, Progressed):
                    tell(event.stage)
                else:
                    return event
    return None


@dataclass(frozen=True)
class _Call:
    """A fruit that starts where this object is unpickled."""

    order: FruitOrder
    topic: str

    def __reduce__(self) -> tuple:
        return fruit_on_worker, (self.order, self.topic)


def packed_fruit(order: FruitOrder, topic: str) -> bytes:
    """The pickle of a fruit for a worker, whose task is `pickle.loads`, which every worker has. A worker that
    cannot load drupe then fails in the task; if dask itself cannot unpickle, the worker ends silently.
    """
    return pickle.dumps(_Call(order, topic))


def fruit_on_worker(order: FruitOrder, topic: str) -> Event | Unfit | None:
    """On a worker: grades one fruit, and sends its stages to the run that ordered it."""
    worker = get_worker()
    key = worker.get_current_task()
    limit = worker.memory_manager.memory_limit
    most_MiB = max(0.0, limit / 2**20 - OWN_MIB) if limit else None
    if why := unfit(order.needs, threads=worker.state.nthreads, most_MiB=most_MiB):
        return Unfit(why, worker.address)

    def wanted() -> bool:
        """False once the run cancels the fruit or ends, or the worker loses its scheduler."""
        task = worker.state.tasks.get(key)
        return worker.status in WORKING and task is not None and task.state == "executing"

    def tell(stage: str) -> None:
        worker.log_event(topic, (order.fruit_id, stage))

    try:
        return fruit_here(order, tell=tell, wanted=wanted, most_MiB=most_MiB)
    except BatchRefused as refused:
        return Unfit(str(refused), worker.address)

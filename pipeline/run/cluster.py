"""Many fruits on many machines: dask.distributed behind the interface of pipeline.run.scheduling.

Each fruit is a task. Its worker grades it in a process of its own (pipeline.run.cluster_worker), as a run on
one machine would: time limits, crashes and results are equal. All machines share a file system. The scheduler
gives the fruit of a lost worker to another worker, and dask-jobqueue replaces Slurm jobs that end. Only this
file and pipeline.run.cluster_worker import dask.
"""

import logging
import os
import pickle
import shlex
import shutil
import signal
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Self

import dask
from distributed import Client, Future, KilledWorker, Security
from distributed.core import Status

from pipeline.batch.scratch import scratch
from pipeline.problem import BatchRefused, refused
from pipeline.run.cluster_worker import OWN_MIB, FruitOrder, RunNeeds, Unfit, packed_fruit
from pipeline.run.scheduling import Died, Event, Finished, Progressed

CONNECT_S = 20.0
"""Seconds in which a scheduler must answer. Set by hand: on a busy login node it takes a few."""
LOOK_S = 0.1
"""Seconds to wait for news."""
COUNT_S = 1.0
"""Seconds between two counts of the workers."""
ANSWER_S = 60.0
"""Seconds in which sbatch must accept or refuse the first jobs; drupe does not wait for later ones. Set by
hand: a busy controller of Slurm answers in some ten."""
ROUNDED = 1.01
"""dask-jobqueue rounds a worker's memory to two digits of GiB, which may be less than requested."""


class Cluster:
    """Workers of dask.distributed: of a scheduler's `address`, or (None) of `workers` jobs of Slurm.

    Raises BatchRefused if a worker is unfit for the run, or if the connection to the scheduler is lost.
    `most`: most fruit in the cluster at once; `tell` gets sentences for staff.
    """

    def __init__(
        self,
        address: str | None,
        *,
        workers: int = 0,
        needs: RunNeeds,
        time_limit_s: float,
        tell: Callable[[str], None],
        most: int | None = None,
    ) -> None:
        self._asked, self._asked_workers = address, workers
        self._needs, self._time_limit_s, self._tell, self._most = needs, time_limit_s, tell, most
        self._held = ExitStack()
        self._happened: SimpleQueue[tuple[str, Future | str]] = SimpleQueue()
        self._fruits: dict[str, Future] = {}
        self._workers, self._counted_s = 0, -float("inf")
        self._topic = f"drupe-{uuid.uuid4().hex}"

    def __enter__(self) -> Self:
        """Finds the scheduler, or starts one and asks Slurm for workers; raises BatchRefused."""
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # drupe has its own messages
        with ExitStack() as held:
            security, self._address = None, self._asked or ""
            if self._asked is None:
                jobs = held.enter_context(slurm_jobs(self._asked_workers, self._needs, self._tell))
                self._address, security = str(jobs.scheduler_address), jobs.security
            self._client = self._connected(security)
            self._connection = self._client.scheduler_comm
            held.callback(self._disconnect)
            self._client.subscribe_topic(self._topic, lambda event: self._happened.put(event[1]))
            self._look()
            workers = f"{self._workers} worker{'' if self._workers == 1 else 's'}"
            dashboard = self._client.dashboard_link or "none"
            self._tell(f"cluster at {self._address}: {workers}; dashboard {dashboard}")
            if not self._workers:
                here = f"dask worker {self._address} --nthreads 1"
                how = "Slurm; `squeue` shows its jobs" if self._asked is None else here
                self._tell(f"waiting for workers ({how})")
            self._held = held.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Cancels unfinished fruit; workers then end the fruit's processes."""
        self._held.close()

    def room(self) -> int:
        """How many more fruit it takes now: one per worker, before there are any one per requested worker."""
        self._look()
        there = self._workers or self._asked_workers or 1
        return (there if self._most is None else min(there, self._most)) - len(self._fruits)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Hands a fruit to the scheduler."""
        order = FruitOrder(
            fruit_id=fruit_id, packed=packed, time_limit_s=self._time_limit_s, needs=self._needs
        )
        key, call = f"fruit-{uuid.uuid4().hex}", packed_fruit(order, self._topic)
        future = self._fruits[fruit_id] = self._client.submit(pickle.loads, call, key=key, pure=False)
        future.add_done_callback(lambda done: self._happened.put((fruit_id, done)))

    def happened(self) -> Iterator[Event]:
        """Stages and endings since the last call."""
        self._look()
        with suppress(Empty):
            yield from self._events(*self._happened.get(timeout=LOOK_S))
            while True:
                yield from self._events(*self._happened.get_nowait())

    def _look(self) -> None:
        """Counts workers now and then; raises BatchRefused if the scheduler is lost. A client that reconnects
        by itself has lost its fruit.
        """
        if self._client.status != "running" or self._client.scheduler_comm is not self._connection:
            raise self._lost()
        if time.monotonic() - self._counted_s > COUNT_S:
            self._counted_s = time.monotonic()
            with suppress(Exception):  # without an answer, the last count stays
                self._workers = len(self._client.scheduler_info(n_workers=-1)["workers"])

    def _lost(self) -> BatchRefused:
        sentence = "the scheduler is lost. drupe kept the finished fruit; run the same command again."
        return refused(self._address, sentence)

    def _events(self, fruit_id: str, news: Future | str) -> Iterator[Event]:
        if fruit_id not in self._fruits:
            return
        if isinstance(news, str):
            yield Progressed(fruit_id, news)
        else:
            del self._fruits[fruit_id]
            yield self._ending(fruit_id, news)

    def _ending(self, fruit_id: str, future: Future) -> Event:
        """How a fruit ended; raises BatchRefused if its worker is unfit, or if the scheduler is lost."""
        try:
            ended = future.result(timeout=CONNECT_S)
        except KilledWorker as killed:
            lost, last = killed.allowed_failures + 1, killed.last_worker.address
            return Died(fruit_id, None, f"{lost} workers died with it, the last {last}")
        except (ImportError, AttributeError) as error:
            sentence = (
                f"a worker cannot load this drupe ({type(error).__name__}: {error}); install the same drupe "
                "on both, with the extra cluster."
            )
            raise refused(self._address, sentence) from None
        except Exception as error:  # noqa: BLE001 - dask's own, of which there are many kinds
            if future.status != "error":
                raise self._lost() from None
            return Finished(fruit_id, error)
        if isinstance(ended, Unfit):
            raise refused(f"worker {ended.worker}", ended.sentence)
        return ended or Died(fruit_id, None, "its worker was stopped")

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
            self._client.cancel([*self._fruits.values()], force=True)
        with suppress(Exception):
            self._client.close(timeout=CONNECT_S)


@contextmanager
def slurm_jobs(workers: int, needs: RunNeeds, tell: Callable[[str], None]) -> Iterator[Any]:
    """Yields the cluster: a scheduler in this process and `workers` jobs of Slurm, replaced as they end.
    Settings of dask-jobqueue (~/.config/dask/jobqueue.yaml) give queue, account and time.

    Scheduler, workers and client use TLS with a key for this run only. Its hidden folder beside the results
    is removed afterwards (files of mode 0600). Raises BatchRefused with the answer of sbatch if Slurm accepts
    no job.
    """
    if shutil.which("sbatch") is None:
        sentence = "found no sbatch; run this command on a machine that submits jobs, or use --scheduler."
        raise refused("--slurm", sentence)
    jobqueue, answers = _jobqueue(), SimpleQueue[str]()
    with ExitStack() as held:
        folder = held.enter_context(scratch(near=needs.run.parent))
        if shlex.quote(str(folder)) != str(folder):
            sentence = (
                f"cannot give Slurm's jobs the key in {folder}, whose name has blanks or other marks of the "
                "shell; choose another --out."
            )
            raise refused("--slurm", sentence)
        try:
            cluster = jobqueue.SLURMCluster(
                job_cls=_job_class(jobqueue, answers),
                security=_certified(folder),
                cores=1,
                processes=1,
                memory=f"{ROUNDED * (needs.per_fruit_MiB + OWN_MIB):.0f} MiB",
                job_name="drupe",
                python=sys.executable,
                job_script_prologue=[
                    *(dask.config.get("jobqueue.slurm.job-script-prologue", None) or []),
                    "export PYTHONSAFEPATH=1",
                ],
            )
        except (OSError, ValueError, RuntimeError) as error:
            raise refused("--slurm", f"Slurm does not work ({error}).") from None
        held.enter_context(cluster)
        cluster.adapt(minimum=workers, maximum=workers)
        taken, said = 0, ""
        with suppress(Empty):
            for _ in range(workers):
                words = answers.get(timeout=ANSWER_S)
                taken, said = taken + (not words), words or said
        if said and not taken:
            sentence = f"sbatch accepts no job ({said}); check ~/.config/dask/jobqueue.yaml."
            raise refused("--slurm", sentence)
        if said:
            tell(f"Slurm accepted {taken} of {workers} jobs ({said}); drupe works with these")
        yield cluster


def _certified(folder: Path) -> Security:
    """A new key and its certificate, in two files of mode 0600, for scheduler, workers and client."""
    made = Security.temporary()
    files = {"cert": made.tls_ca_file, "key": made.tls_worker_key}
    for name, content in files.items():
        with os.fdopen(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(content)
    of_roles = {
        f"tls_{role}_{name}": str(folder / name)
        for role in ("client", "scheduler", "worker")
        for name in files
    }
    return Security(require_encryption=True, tls_ca_file=str(folder / "cert"), **of_roles)


def _jobqueue() -> Any:
    """dask_jobqueue. Its import changes the handler of Ctrl-C, which would end the run without a report."""
    ctrl_c = signal.getsignal(signal.SIGINT)
    try:
        import dask_jobqueue
    finally:
        if ctrl_c is not None:
            signal.signal(signal.SIGINT, ctrl_c)
    return dask_jobqueue


def _job_class(jobqueue: Any, answers: SimpleQueue[str]) -> type:
    """dask-jobqueue's job class; `answers` gets the error of sbatch for each job, empty if accepted."""

    class Job(jobqueue.SLURMCluster.job_cls):  # type: ignore[misc]  # a class of no known type
        async def start(self) -> None:
            """Submits the job."""
            try:
                await super().start()
                answers.put("")
            except (OSError, RuntimeError, ValueError) as error:
                self.status = Status.running  # else dask logs it as its own fault
                said = str(error).partition("stderr:\n")[2].strip() or str(error)
                answers.put(" ".join(said.split()))

        async def close(self) -> None:
            """Cancels the job, and sets the status that dask expects."""
            await super().close()
            self.status = Status.closed

    return Job

"""Workers of dask.distributed as jobs of Slurm (dask-jobqueue), with a scheduler in this process."""

import copy
import os
import shlex
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import dask
from distributed import Security
from distributed.core import Status

from pipeline.problem import refused
from pipeline.run.cluster_worker import OWN_MIB

_refused = partial(refused, "--slurm")
ANSWER_S = 60.0
"""Seconds in which sbatch must take or refuse the first jobs; later ones are not waited for. Set by hand: a
busy controller of Slurm answers in some ten."""
AGAIN_S = 60.0
"""Seconds after which jobs that sbatch refused are asked for again. Set by hand: a job's place in the queue
is seldom free sooner."""


class SlurmJobs:
    """Jobs of one worker each; `refusal` is what sbatch said when it last refused one, or empty."""

    def __init__(self) -> None:
        self.refusal = ""
        self.cluster: Any = None
        self.answers: SimpleQueue[str] = SimpleQueue()
        self._refused: list[Any] = []
        self._asked_s = -float("inf")

    async def ask(self, job: Any, submit: Callable[[], Any]) -> None:
        """Submits one job; one that is refused is kept, and asked for again by `look`."""
        self._asked_s = time.monotonic()
        try:
            await submit()
            words = ""
        except (OSError, RuntimeError, ValueError) as error:
            words = _words(error)
            self._refused.append(job)
            self.refusal = words
            job.status = Status.running  # else dask takes it for a fault of its own, and logs a traceback
        self.answers.put(words)

    def look(self) -> None:
        """Asks again for the jobs that were refused, now and then."""
        if self._refused and time.monotonic() - self._asked_s > AGAIN_S:
            self._asked_s = time.monotonic()
            self.cluster.loop.add_callback(self._ask_again)

    async def _ask_again(self) -> None:
        refused, self._refused, self.refusal = self._refused, [], ""
        for job in refused:
            if self.cluster.status == Status.running and job.name in self.cluster.worker_spec:
                await job.start()


@contextmanager
def slurm_jobs(
    workers: int, per_fruit_MiB: float, tell: Callable[[str], None], *, certificates: Path | None = None
) -> Iterator[SlurmJobs]:
    """A scheduler in this process and `workers` jobs of Slurm, replaced as they end; queue, account and time
    are those of dask-jobqueue's own settings (~/.config/dask/jobqueue.yaml).

    `certificates`: a folder of this user's own that all machines see. A key and a certificate of this run
    alone are written there (mode 0600, gone afterwards), and scheduler, workers and client speak TLS with
    them; None: plain TCP. Raises BatchRefused where Slurm takes none of the jobs, with what sbatch said.
    """
    if shutil.which("sbatch") is None:
        raise _refused(
            "found no sbatch; run this command on a machine that submits jobs, or use --scheduler."
        )
    jobqueue = _jobqueue()
    memory_MiB, jobs = per_fruit_MiB + OWN_MIB, SlurmJobs()
    try:
        cluster = jobqueue.SLURMCluster(
            job_cls=_job_class(jobqueue, jobs),
            security=None if certificates is None else _certified(certificates),
            cores=1,
            processes=1,
            memory=f"{memory_MiB:.0f} MiB",
            job_name="drupe",
            python=sys.executable,
            job_script_prologue=[*_configured("job-script-prologue"), "export PYTHONSAFEPATH=1"],
        )
    except (OSError, ValueError, RuntimeError) as error:
        raise _refused(f"Slurm does not work ({error}).") from None
    with cluster:
        jobs.cluster = cluster
        cluster.adapt(minimum=workers, maximum=workers)
        taken, denied = _first_answers(jobs.answers, workers)
        if denied and not taken:
            raise _refused(f"sbatch accepts no job ({jobs.refusal}); check ~/.config/dask/jobqueue.yaml.")
        if denied:
            tell(
                f"Slurm accepted {taken} of {workers} jobs ({jobs.refusal}); drupe submits the others "
                f"again every {AGAIN_S:.0f} s"
            )
        yield jobs


def _first_answers(answers: SimpleQueue[str], workers: int) -> tuple[int, int]:
    """How many of the first jobs were taken, and how many refused."""
    taken, refused, end_s = 0, 0, time.monotonic() + ANSWER_S
    while taken + refused < workers:
        try:
            words = answers.get(timeout=max(0.0, end_s - time.monotonic()))
        except Empty:
            break
        taken, refused = taken + (not words), refused + bool(words)
    return taken, refused


def _jobqueue() -> Any:
    """dask_jobqueue, whose import changes what Ctrl-C does: it would end the run with nothing written."""
    ctrl_c = signal.getsignal(signal.SIGINT)
    try:
        import dask_jobqueue
    finally:
        if ctrl_c is not None:
            signal.signal(signal.SIGINT, ctrl_c)
    return dask_jobqueue


def _job_class(jobqueue: Any, jobs: SlurmJobs) -> type:
    """dask-jobqueue's job, whose refusals are kept, with its memory limit to the byte."""

    class Job(jobqueue.SLURMCluster.job_cls):  # type: ignore[misc]  # a class of no known type
        def __init__(self, *args: Any, security: Security | None = None, **options: Any) -> None:
            super().__init__(*args, security=None if security is None else _quoted(security), **options)

        @property
        def worker_process_memory(self) -> str:
            """Bytes: dask-jobqueue's own would round to two digits of GiB, and so below a fruit's need."""
            return f"{self.worker_memory}B"

        async def start(self) -> None:
            """Submits it."""
            await jobs.ask(self, super().start)

        async def close(self) -> None:
            """Takes it back; dask wants to see that it is closed."""
            await super().close()
            self.status = Status.closed

    return Job


def _certified(folder: Path) -> Security:
    """A new key and its certificate, in two files of mode 0600, for scheduler, workers and client alike."""
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


def _quoted(security: Security) -> Security:
    """With the paths of certificates as words of a shell: dask-jobqueue puts them into a script."""
    quoted = copy.copy(security)
    for name in ("tls_ca_file", "tls_worker_key", "tls_worker_cert"):
        setattr(quoted, name, shlex.quote(getattr(security, name)))
    return quoted


def _configured(name: str) -> list[str]:
    return dask.config.get(f"jobqueue.slurm.{name}", None) or []


def _words(error: Exception) -> str:
    said = str(error).partition("stderr:\n")[2].strip() or str(error)
    return " ".join(said.split())

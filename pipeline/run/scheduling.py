"""The interface between a run and the engine that grades its fruit: this machine or a cluster."""

import importlib.util
import pickle
import re
import uuid
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from pipeline.problem import refused

ADDRESS = re.compile(r"([a-z]+://)?[^/\s]+:[0-9]+/?")
"""Address of a scheduler: host and port, with or without the protocol."""


@dataclass(frozen=True, kw_only=True)
class WorkPlace:
    """Where fruit are graded: here, by a dask `scheduler` (its address), or in jobs of `slurm`.

    `jobs`: most fruit at the same time; None: as many as there are workers. `mark`: identifies the folder of
    this run.
    """

    jobs: int | None = None
    scheduler: str | None = None
    slurm: bool = False
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)

    @property
    def here(self) -> bool:
        """Whether this machine grades the fruit."""
        return self.scheduler is None and not self.slurm

    def require_parts(self) -> None:
        """Raises BatchRefused if options contradict each other, or a package is not installed."""
        if self.here:
            return
        if self.slurm and self.scheduler is not None:
            raise refused("--slurm", "conflicts with --scheduler; give only one of them.")
        if self.slurm and self.jobs is None:
            raise refused("--slurm", "needs --jobs, the number of Slurm jobs.")
        if self.scheduler is not None and not ADDRESS.fullmatch(self.scheduler):
            sentence = (
                f'found "{self.scheduler}"; expected the address that `dask scheduler` prints, with its port.'
            )
            raise refused("--scheduler", sentence)
        for name in ("distributed", *(("dask_jobqueue", "cryptography") if self.slurm else ())):
            if importlib.util.find_spec(name) is None:
                sentence = f"needs the package {name}; install it with: pip install 'drupe[cluster]'."
                raise refused("--slurm" if self.slurm else "--scheduler", sentence)


@dataclass(frozen=True)
class Progressed:
    """A fruit has begun a stage."""

    fruit_id: str
    stage: str


@dataclass(frozen=True)
class Noted:
    """A library wrote a line while a fruit was graded."""

    fruit_id: str
    line: str


@dataclass(frozen=True)
class Finished:
    """A fruit's process has ended; `result` is what it returned, or the exception that ended it."""

    fruit_id: str
    result: Any


@dataclass(frozen=True)
class Died:
    """A fruit's process died (signal, out-of-memory killer), did not start, or lost its machine (`how`)."""

    fruit_id: str
    exit_code: int | None
    how: str = ""


@dataclass(frozen=True)
class TimedOut:
    """A fruit's process was stopped at the time limit."""

    fruit_id: str


def not_begun(fruit_id: str, error: OSError) -> Died:
    """The ending of a fruit whose process could not start, or died before it received its task."""
    return Died(fruit_id, None, f"its process did not start: {error.strerror or error}")


Event = Progressed | Noted | Finished | Died | TimedOut
Report = Callable[[str], None]
Work = Callable[[Any, Report], Any]


class Engine(Protocol):
    """Grades fruit, one process each; a context manager, whose end stops its unfinished fruit.

    The two engines are pipeline.run.runner.LocalPool (processes of this machine) and
    pipeline.run.cluster.Cluster (dask.distributed).
    """

    def __enter__(self) -> Self:
        """Prepares the engine; raises BatchRefused if it cannot."""

    def __exit__(self, *_: object) -> None:
        """Stops all unfinished fruit."""

    def room(self) -> int:
        """How many more fruit it takes now. Few fruit wait in it, however large the batch."""

    def begin(self, fruit_id: str, packed: bytes) -> None:
        """Starts a fruit: `packed` is the pickle of (work, task), opened in the fruit's own process. Raises
        OSError if no process can start.
        """

    def happened(self) -> Iterable[Event]:
        """Events since the last call; waits a moment if there are none. Every started fruit ends with one
        event that is neither Progressed nor Noted.
        """


def run_on(engine: Engine, work: Work, tasks: Iterable[tuple[str, Any]]) -> Generator[Event, None, None]:
    """Runs `work(task, report)` for each (fruit_id, task) and yields events as they happen.

    It takes the next of `tasks` when the engine is free for one; one that is `Finished` needs no work.
    Leaving the iterator early stops running fruit.
    """
    waiting, all_begun, begun = iter(tasks), False, 0
    with engine:
        while True:
            while not all_begun and engine.room() > 0:
                next_task = next(waiting, None)
                if next_task is None:
                    all_begun = True
                    break
                fruit_id, task = next_task
                if isinstance(task, Finished):
                    yield task
                    continue
                try:
                    engine.begin(fruit_id, pickle.dumps((work, task)))
                    begun += 1
                except OSError as error:
                    yield not_begun(fruit_id, error)
            if all_begun and not begun:
                return
            for event in engine.happened():
                begun -= not isinstance(event, (Progressed, Noted))
                yield event

"""Progress for people: a live bar with the time left on a terminal, plain lines in a log."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pipeline.run.console import RunConsole
from pipeline.run.time_left import TimeLeft


class BatchProgress:
    """Shows which fruit is at which stage, how many are done, and when the rest will be.

    `total`: fruit that are still to be done. `before`: those of a watched batch that were done before; they
    are counted with these, as those that have come so far. None: the batch is not watched.
    """

    def __init__(
        self,
        console: Console,
        *,
        total: int,
        jobs: int,
        before: int | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._console = console
        self._lines = not console.is_terminal or (isinstance(console, RunConsole) and console.verbose)
        self._total, self._done = total + (before or 0), before or 0
        self._what = "" if before is None else " that have come"
        self._clock = clock
        self._started = clock()
        self._time_left = TimeLeft(total=total, jobs=jobs, clock=clock)
        self._stage: dict[str, str] = {}
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task("grading", total=self._total, completed=self._done, left="")

    @property
    def jobs(self) -> int:
        """How many fruit are worked on at the same time, by which the time left is reckoned."""
        return self._time_left.jobs

    @jobs.setter
    def jobs(self, jobs: int) -> None:
        self._time_left.jobs = jobs

    def __enter__(self) -> Self:
        """Starts the bar on a terminal."""
        if not self._lines:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Takes the bar away."""
        self._bar.stop()

    def stage(self, fruit_id: str, stage: str) -> None:
        """A fruit begins a stage."""
        self._stage[fruit_id] = stage
        self._time_left.stage(fruit_id, stage)
        if not self._lines:
            if isinstance(self._console, RunConsole):
                self._console.note(f"{fruit_id}: {stage}")
            running = ", ".join(f"{name}: {at}" for name, at in self._stage.items())
            self._bar.update(self._task, description=running, left=self._left())
        else:
            self._console.print(f"[{self._elapsed()}] {fruit_id}: {stage}", highlight=False, markup=False)

    def noted(self, fruit_id: str, line: str) -> None:
        """A library wrote a line while it worked on a fruit."""
        if isinstance(self._console, RunConsole):
            stage = self._stage.get(fruit_id, "").partition(":")[0]
            self._console.of_library(f"{fruit_id}{f' ({stage})' if stage else ''}: {line}")

    def done(self, fruit_id: str, sentence: str, *, whole: bool) -> None:
        """A fruit has ended, after its last stage (`whole`) or in the middle of one."""
        self._stage.pop(fruit_id, None)
        self._time_left.done(fruit_id, whole=whole)
        self._done += 1
        left = self._left()
        self._bar.update(self._task, completed=self._done, left=left)
        note = f" ({self._done} of {self._total}{self._what}{', ' + left if left else ''})"
        self._console.print(
            f"[{self._elapsed()}] {fruit_id}: {sentence}{note}", highlight=False, markup=False, soft_wrap=True
        )

    def _elapsed(self) -> str:
        return _clock_face(self._clock() - self._started)

    def _left(self) -> str:
        seconds = self._time_left.seconds()
        return "" if seconds is None or self._done == self._total else f"about {_clock_face(seconds)} left"


class StageLines:
    """One fruit's stages, a line each, with the time since the start."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._started = time.monotonic()

    def stage(self, name: str) -> None:
        """A stage begins."""
        elapsed = _clock_face(time.monotonic() - self._started)
        self._console.print(f"[{elapsed}] {name}", highlight=False, markup=False, soft_wrap=True)


def _clock_face(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes:02d}:{seconds:02d}"

"""Progress for people: a live bar with the time left on a terminal, plain lines in a log."""

import heapq
import threading
import time
from collections.abc import Callable, Iterable
from typing import Self

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from pipeline.run.console import RunConsole

MOST_LINES = 8
"""Fruit at work whose stages are shown below the bar."""
WORDS_COLUMNS = 60
"""Columns of the terminal that the words beside the bar take at most."""
UNKNOWN = "time remaining unknown"


class TimeLeft:
    """Each fruit takes what whole fruit took on average so far, and those that wait go to the processes as
    they become free. Fruit that ended early count only while no other has ended.
    """

    def __init__(self, *, total: int, jobs: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.jobs, self._waiting, self._clock = jobs, total, clock
        self._begun: dict[str, float] = {}
        self._took: dict[bool, list[float]] = {True: [], False: []}

    def begun(self, fruit_id: str) -> None:
        """A fruit is worked on, for the first time or still."""
        if fruit_id not in self._begun:
            self._waiting -= 1
            self._begun[fruit_id] = self._clock()

    def done(self, fruit_id: str, *, whole: bool) -> None:
        """A fruit has ended, after its last stage (`whole`) or in the middle of one."""
        if fruit_id in self._begun:
            self._took[whole].append(self._clock() - self._begun.pop(fruit_id))
        else:
            self._waiting -= 1

    def seconds(self) -> float | None:
        """Until the last fruit has ended; None while that is not known."""
        took = self._took[True] or self._took[False]
        if not took:
            return None
        mean_s, now_s = sum(took) / len(took), self._clock()
        free = [max(0.0, mean_s - (now_s - begun)) for begun in self._begun.values()]
        free += [0.0] * (self.jobs - len(free))
        heapq.heapify(free)
        for _ in range(self._waiting):
            heapq.heapreplace(free, free[0] + mean_s)
        return max(free)


class _Said(ProgressColumn):
    """What is known at the moment of drawing."""

    def __init__(self, say: Callable[[], str]) -> None:
        super().__init__()
        self._say = say

    def render(self, task: Task) -> Text:  # noqa: ARG002 - there is one task
        return Text(self._say(), no_wrap=True)


class _Bar(Progress):
    """One bar for the batch, and below it a line for each fruit at work, cut to the terminal's width."""

    def __init__(self, *columns: ProgressColumn, console: Console, lines: Callable[[], list[str]]) -> None:
        self._stage_lines = lines
        super().__init__(*columns, console=console, transient=True)

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        yield from (Text(line, no_wrap=True, overflow="ellipsis") for line in self._stage_lines())


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
        self._lock = threading.Lock()  # the bar is drawn by a thread of its own
        self._bar = _Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=min(40, max(10, console.width - WORDS_COLUMNS))),
            MofNCompleteColumn(),
            _Said(lambda: self._elapsed() + (f", {left}" if (left := self._left(UNKNOWN)) else "")),
            console=console,
            lines=self._at_work,
        )
        self._bar.live.vertical_overflow = "crop"
        self._task = self._bar.add_task("graded", total=self._total, completed=self._done)

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

    def __exit__(self, *_: object) -> None:
        """Takes the bar away."""
        self._bar.stop()

    def stage(self, fruit_id: str, stage: str) -> None:
        """A fruit begins a stage."""
        with self._lock:
            self._stage[fruit_id] = stage
            self._time_left.begun(fruit_id)
        if not self._lines:
            if isinstance(self._console, RunConsole):
                self._console.note(f"{fruit_id}: {stage}")
        else:
            self._console.print(f"[{self._elapsed()}] {fruit_id}: {stage}", highlight=False, markup=False)

    def noted(self, fruit_id: str, line: str) -> None:
        """A library wrote a line while it worked on a fruit."""
        if isinstance(self._console, RunConsole):
            stage = self._stage.get(fruit_id, "").partition(":")[0]
            self._console.of_library(f"{fruit_id}{f' ({stage})' if stage else ''}: {line}")

    def done(self, fruit_id: str, sentence: str, *, whole: bool) -> None:
        """A fruit has ended, after its last stage (`whole`) or in the middle of one."""
        with self._lock:
            self._stage.pop(fruit_id, None)
            self._time_left.done(fruit_id, whole=whole)
            self._done += 1
        left = self._left()
        self._bar.update(self._task, completed=self._done)
        note = f" ({self._done} of {self._total}{self._what}{', ' + left if left else ''})"
        self._console.print(
            f"[{self._elapsed()}] {fruit_id}: {sentence}{note}", highlight=False, markup=False, soft_wrap=True
        )

    def _elapsed(self) -> str:
        return _clock_face(self._clock() - self._started)

    def _left(self, unknown: str = "") -> str:
        with self._lock:
            if self._done == self._total:
                return ""
            seconds = self._time_left.seconds()
        return unknown if seconds is None else f"about {_clock_face(seconds)} left"

    def _at_work(self) -> list[str]:
        with self._lock:
            lines = [f"  {name}: {at}" for name, at in self._stage.items()]
        more = len(lines) - MOST_LINES
        return lines if more <= 1 else [*lines[:MOST_LINES], f"  and {more} more fruit"]


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

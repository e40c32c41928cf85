"""Progress for people: a live bar with the time left on a terminal, plain lines in a log."""

import time
from collections.abc import Callable
from typing import Self

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

MOST_LINES = 8
"""Most fruit whose stages are shown below the bar."""
LEAST_DONE = 2
"""Fruit after which drupe states the time left: one fruit does not show how long others take."""


class RunConsole(Console):
    """Standard error. `quiet`: shows nothing; `verbose`: shows a line for every stage of every fruit and
    every line that libraries write, on a terminal too.
    """

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        super().__init__(stderr=True, quiet=quiet)
        self.verbose = verbose


def say(console: Console, sentence: str, *, style: str | None = None) -> None:
    """Prints a sentence on one line, without markup or highlighting."""
    console.print(sentence, style=style, highlight=False, markup=False, soft_wrap=True)


class BatchProgress:
    """Shows the stage of each fruit, the number of finished fruit, and the time left.

    `total`: fruit still to grade. `before`: fruit of a watched batch that were finished earlier; the counts
    include them, and name the total as fruit that have come. None: the batch is not watched.
    """

    def __init__(
        self,
        console: Console,
        *,
        total: int,
        before: int | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._console = console
        self._verbose = isinstance(console, RunConsole) and console.verbose
        self._lines = self._verbose or not console.is_terminal
        self._total, self._done = total + (before or 0), before or 0
        self._what = "" if before is None else " that have come"
        self._clock, self._started = clock, clock()
        self._stage: dict[str, str] = {}
        self._began: dict[str, float] = {}
        self._took_s: list[float] = []
        self._most_at_once = 1
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            _TimeLeft(self._left_s),
            console=console,
            transient=True,
            get_time=clock,
        )
        self._task = self._bar.add_task("graded", total=self._total, completed=self._done)

    def __enter__(self) -> Self:
        if not self._lines:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def stage(self, fruit_id: str, stage: str) -> None:
        """A fruit begins a stage."""
        self._stage[fruit_id] = stage
        self._began.setdefault(fruit_id, self._clock())
        self._most_at_once = max(self._most_at_once, len(self._began))
        self._bar.update(self._task, description=self._at_work())
        if self._lines:
            say(self._console, f"[{self._elapsed()}] {fruit_id}: {stage}")

    def noted(self, fruit_id: str, line: str) -> None:
        """A library wrote a line while drupe graded a fruit."""
        if self._verbose:
            stage = self._stage.get(fruit_id, "").partition(":")[0]
            say(self._console, f"{fruit_id}{f' ({stage})' if stage else ''}: {line}", style="dim")

    def done(self, fruit_id: str, sentence: str) -> None:
        """A fruit has ended."""
        self._stage.pop(fruit_id, None)
        self._done += 1
        if (began_s := self._began.pop(fruit_id, None)) is not None:
            self._took_s.append(self._clock() - began_s)
        self._bar.update(self._task, completed=self._done, description=self._at_work())
        seconds = self._left_s()
        left = f", about {_clock_face(seconds)} left" if seconds else ""
        note = f" ({self._done} of {self._total}{self._what}{left})"
        say(self._console, f"[{self._elapsed()}] {fruit_id}: {sentence}{note}")

    def _left_s(self) -> float | None:
        """Seconds until the last fruit ends: remaining work by the mean time of a fruit, over the workers."""
        fruit_left = self._total - self._done
        if len(self._took_s) < LEAST_DONE or not fruit_left:
            return None
        mean_s = sum(self._took_s) / len(self._took_s)
        done_s = sum(min(self._clock() - began_s, mean_s) for began_s in list(self._began.values()))
        return (fruit_left * mean_s - done_s) / min(self._most_at_once, fruit_left)

    def _elapsed(self) -> str:
        return _clock_face(self._clock() - self._started)

    def _at_work(self) -> str:
        lines = [f"{name}: {at}" for name, at in self._stage.items()]
        more = len(lines) - MOST_LINES
        shown = lines if more <= 1 else [*lines[:MOST_LINES], f"and {more} more fruit"]
        return escape("\n".join(shown)) or "graded"


class _TimeLeft(ProgressColumn):
    """The bar's time left, in seconds by `left_s`; "--:--" if it is unknown."""

    max_refresh = 0.5

    def __init__(self, left_s: Callable[[], float | None]) -> None:
        super().__init__()
        self._left_s = left_s

    def render(self, task: Task) -> Text:  # noqa: ARG002 - rich gives it
        """The time on the bar."""
        seconds = self._left_s()
        return Text("--:--" if seconds is None else _clock_face(seconds), style="progress.remaining")


class StageLines:
    """One fruit's stages, a line each on standard error, with the time since the start."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._started = time.monotonic()

    def stage(self, name: str) -> None:
        """A stage begins."""
        elapsed = _clock_face(time.monotonic() - self._started)
        say(self._console, f"[{elapsed}] {name}")


def _clock_face(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes:02d}:{seconds:02d}"

"""Progress for people: a live bar with the time left on a terminal, plain lines in a log."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn


class BatchProgress:
    """Shows which fruit is at which stage, how many are done, and when the rest will be."""

    def __init__(self, console: Console, *, total: int) -> None:
        self._console = console
        self._total = total
        self._started = time.monotonic()
        self._done = 0
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
        self._task = self._bar.add_task("grading", total=total, left="")

    def __enter__(self) -> Self:
        """Starts the bar on a terminal."""
        if self._console.is_terminal:
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
        if self._console.is_terminal:
            running = ", ".join(f"{name}: {at}" for name, at in self._stage.items())
            self._bar.update(self._task, description=running)
        else:
            self._console.print(f"[{self._elapsed()}] {fruit_id}: {stage}", highlight=False, markup=False)

    def done(self, fruit_id: str, sentence: str) -> None:
        """A fruit has ended."""
        self._stage.pop(fruit_id, None)
        self._done += 1
        left = self._left()
        self._bar.update(self._task, completed=self._done, left=left)
        note = f" ({self._done} of {self._total}{', ' + left if left else ''})"
        self._console.print(
            f"[{self._elapsed()}] {fruit_id}: {sentence}{note}", highlight=False, markup=False, soft_wrap=True
        )

    def _elapsed(self) -> str:
        return _clock_face(time.monotonic() - self._started)

    def _left(self) -> str:
        remaining = self._total - self._done
        if not remaining:
            return ""
        per_fruit = (time.monotonic() - self._started) / self._done
        return f"about {_clock_face(per_fruit * remaining)} left"


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

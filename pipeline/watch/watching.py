"""The loop of `drupe watch`: fruit are graded as they arrive, one after the other."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from pipeline.batch.fruits_table import FruitRow, unlisted_fruit
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import Batch, open_batch
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused
from pipeline.run.batch_run import ReportOptions
from pipeline.run.grading import grade
from pipeline.watch.arrivals import Arrival, State, arrival, own_state
from reports.entries import BatchEntry
from reports.kiosk_page import KioskEntry
from reports.language import ENGLISH

EVERY_S = 0.5
"""Seconds between two looks at the folder, at least. Set by hand: nobody notices less."""
SHARE = 0.05
"""Of the time that looking may take: after a look that took t, t over this is waited."""
AGAIN_S = 10.0
"""Seconds after which a batch that was refused is tried again though nothing in it has changed: the cause may
lie elsewhere (another run that writes there, a full disk)."""


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """How the folder is watched: results' place, fruit at once, seconds a fruit may take, whether fruit are
    screened, language of the report, seconds without a change after which a fruit's files are whole, seconds
    without anything new after which watching ends (None: never).
    """

    out: Path
    jobs: int
    time_limit_s: float
    screen: bool
    language: str = ENGLISH
    settle_s: float
    idle_s: float | None = None


@dataclass(kw_only=True)
class BatchWatch:
    """What is known of a watched batch between two looks.

    `show` is told whenever something is to be seen; `clock` in seconds.
    """

    root: Path
    options: WatchOptions
    console: Console
    show: Callable[[KioskEntry], None]
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    arrivals: dict[str, Arrival] = field(default_factory=dict)
    """What lies in the folder of each fruit that has any files."""
    expected: int = 0
    """Rows of the table whose fruit have none yet."""
    seen: dict[str, tuple[State, float]] = field(default_factory=dict)
    """Files of each fruit, and since when they are so."""
    tried: dict[str, tuple[State, State]] = field(default_factory=dict)
    """Files of the batch and of the fruit when it was last graded."""
    recent: list[str] = field(default_factory=list)
    """Fruit in the order in which they were graded, the last first."""
    entry: BatchEntry | None = None
    status: int = 0
    at_work: bool = False

    def run(self) -> int:
        """Watches until nothing new has come for `idle_s`; the exit status of the last grading."""
        self._begin_with_earlier_results()
        quiet_since, refused_at = self.clock(), -float("inf")
        before: tuple[State, tuple[tuple[str, State], ...]] | None = None
        while True:
            began = self.clock()
            own = own_state(BatchFolder(self.root))
            batch, problems = self._opened()
            now = own, tuple((name, one.state) for name, one in self.arrivals.items())
            if now != before:
                before, quiet_since, refused_at = now, self.clock(), -float("inf")
                self._tell(problems)
            chosen = self._chosen(own)
            if batch is not None and chosen and self.clock() - refused_at >= AGAIN_S:
                done = self._grade(batch, own, chosen)
                refused_at = -float("inf") if done else self.clock()
                quiet_since = self.clock() if done else quiet_since
                continue
            waiting = any(self._since(name) < self.options.settle_s for name in self.arrivals)
            idle_s = self.options.idle_s
            if idle_s is not None and not waiting and self.clock() - quiet_since >= idle_s:
                return self.status
            self.sleep(max(EVERY_S, (self.clock() - began) / SHARE))

    def _opened(self) -> tuple[Batch | None, tuple[str, ...]]:
        """The batch with the fruit that are whole, or why it cannot be graded."""
        try:
            return open_batch(self.root, choose=self._whole), ()
        except BatchRefused as refused:
            return None, tuple(str(problem) for problem in refused.problems)

    def _whole(self, folder: BatchFolder, rows: tuple[FruitRow, ...]) -> tuple[FruitRow, ...]:
        """Looks into the folder of every fruit, listed or not; those that lack nothing."""
        rows = (*rows, *unlisted_fruit(folder.root / "fruits", rows))
        self.arrivals = {}
        for row in rows:
            one = arrival(folder.fruit(row.fruit_id), row)
            if one.state:
                self.arrivals[row.fruit_id] = one
                if self.seen.get(row.fruit_id, ((), 0.0))[0] != one.state:
                    self.seen[row.fruit_id] = one.state, self.clock()
        self.expected = len(rows) - len(self.arrivals)
        return tuple(
            row for row in rows if row.fruit_id in self.arrivals and not self.arrivals[row.fruit_id].missing
        )

    def _since(self, name: str) -> float:
        """Seconds for which a fruit's files are as they are."""
        return self.clock() - self.seen[name][1]

    def _chosen(self, own: State) -> list[str]:
        """Fruit that are whole, at rest and not graded as they are: as many as are worked on at once, the
        first come first. All that were graded under other settings, at once: most are only read again.
        """
        ready = [
            name
            for name, one in self.arrivals.items()
            if not one.missing
            and self._since(name) >= self.options.settle_s
            and self.tried.get(name) != (own, one.state)
        ]
        again = [name for name in ready if self.tried.get(name, ((), ()))[1] == self.arrivals[name].state]
        return (
            again or sorted(ready, key=lambda name: self.arrivals[name].last_change_ns)[: self.options.jobs]
        )

    def _begin_with_earlier_results(self) -> None:
        """Fruit that earlier runs graded come first, all at once: those that are unchanged are only read."""
        batch, _ = self._opened()
        if batch is None:
            return
        records = {row.fruit_id: Results(self.options.out).fruit(row.fruit_id).record for row in batch.rows}
        there = {name: path.stat().st_mtime for name, path in records.items() if path.is_file()}
        if there:
            in_order = sorted(there, key=lambda name: there[name])
            self._grade(batch, own_state(batch.folder), in_order)

    def _grade(self, batch: Batch, own: State, chosen: list[str]) -> bool:
        """Grades the chosen fruit with those that were graded before; whether the batch could be graded."""
        known, states = {*self.tried, *chosen}, {name: self.arrivals[name].state for name in chosen}
        rows = tuple(row for row in batch.rows if row.fruit_id in known)
        self.at_work = True
        self._tell((), working=chosen)
        try:
            self.status, self.entry = grade(
                self.root,
                self.options.out,
                jobs=self.options.jobs,
                time_limit_s=self.options.time_limit_s,
                console=self.console,
                screen=self.options.screen,
                options=ReportOptions(language=self.options.language),
                opened=replace(batch, rows=rows),
                retried=chosen,
            )
        except (BatchRefused, NotWritten) as fault:
            problems = fault.problems if isinstance(fault, BatchRefused) else [fault]
            self._tell(tuple(str(problem) for problem in problems))
            return False
        finally:
            self.at_work = False
        for name in chosen:
            self.tried[name] = own, states[name]
            self.recent = [name, *(one for one in self.recent if one != name)]
        self._tell(())
        return True

    def _tell(self, problems: tuple[str, ...], *, working: Sequence[str] = ()) -> None:
        """Hands over what is to be seen now; problems also go to the console."""
        for problem in problems:
            self.console.print(problem, highlight=False, markup=False)
        self.show(
            KioskEntry(
                name=self.root.absolute().name,
                batch=self.entry,
                recent=tuple(self.recent),
                working=tuple(working),
                waiting=tuple((name, one.missing) for name, one in self.arrivals.items() if one.missing),
                expected=self.expected,
                problems=problems,
            )
        )

"""The loop of `drupe watch`: fruit are graded as they arrive, one after the other."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from pipeline.batch.fruits_table import FruitRow, unlisted_fruit
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import Batch, open_batch
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused, Problem
from pipeline.run.batch_run import GradeOptions
from pipeline.run.incremental_run import IncrementalRun
from pipeline.watch.arrivals import Arrivals, State, own_state
from reports.kiosk_page import KioskEntry

EVERY_S = 0.5
"""Seconds between two looks at the folder, at least. Set by hand: nobody notices less."""
SHARE = 0.05
"""Of the time that looking may take: after a look that took t, t over this is waited."""
AS_MANY = 10
"""Fruit that are only read again in the time in which a single one is taken in: 20 ms and 0.2 s
(measured with 2000 fruit)."""
AGAIN_S = 10.0
"""Seconds after which a batch that was refused is tried again though nothing in it has changed: the cause may
lie elsewhere (another run that writes there, a full disk)."""


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """How the folder is watched: results' place, how fruit are graded, seconds without a change after which a
    fruit's files are whole, seconds without anything new after which watching ends (None: never).
    """

    out: Path
    grading: GradeOptions
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
    tried: dict[str, tuple[FruitRow, State]] = field(default_factory=dict)
    """Row and files of each fruit when it was last graded."""
    recent: list[str] = field(default_factory=list)
    """Fruit in the order in which their files were graded, the last first."""
    compared_state: State | None = None
    """The batch's own files when all fruit were last held against each other; None: none were yet, or that
    was refused the last time.
    """
    arrivals: Arrivals = field(init=False)
    """What lies in the fruit's folders."""
    graded: IncrementalRun = field(init=False)
    """The fruit so far, their ranking and report."""

    def __post_init__(self) -> None:
        """Its parts, by the watch's options and clock."""
        options = self.options
        self.arrivals = Arrivals(settle_s=options.settle_s, clock=self.clock)
        self.graded = IncrementalRun(
            out=options.out,
            options=options.grading,
            console=self.console,
            tell=self._changed,
            clock=self.clock,
        )

    def run(self) -> int:
        """Watches until nothing new has come for `idle_s`; the exit status of the last report. A fault that
        ends it leaves ranking and report of what is done, as `stop` does after Ctrl-C.
        """
        try:
            return self._run()
        except Exception:
            with suppress(Exception):  # the fault itself is raised
                self.stop()
            raise

    def _run(self) -> int:
        self._begin_with_earlier_results()
        quiet_since, refused_at = self.clock(), -float("inf")
        before: object = None
        named: dict[str, str] = {}
        while True:
            began = self.clock()
            batch_state, batch, problems = self._opened()
            looked_s = self.clock() - began
            if batch is not None:
                self.graded.looked(batch)
            now = (
                batch_state,
                problems,
                tuple((name, arrival.state) for name, arrival in self.arrivals.of.items()),
            )
            if now != before:
                before, quiet_since, refused_at = now, self.clock(), -float("inf")
                self._tell(problems)
            named = self._name_lacking(named)
            if self.clock() - refused_at >= AGAIN_S:
                if batch is not None and (chosen := self._chosen(batch, batch_state)):
                    done = self._grade(batch, batch_state, chosen)
                    refused_at = -float("inf") if done else self.clock()
                    quiet_since = self.clock() if done else quiet_since
                    continue
                if batch is not None and self.graded.report_due:
                    refused_at = -float("inf") if self._report() else self.clock()
                    continue
            idle_s, coming = self.options.idle_s, not all(map(self.arrivals.at_rest, self.arrivals.of))
            if idle_s is not None and not coming and self.clock() - quiet_since >= idle_s:
                if batch is not None and self.graded.uncompared:
                    self._grade(batch, batch_state, [], compare_all=True)
                return self.stop()
            self.sleep(max(EVERY_S, looked_s / SHARE))

    def stop(self) -> int:
        """At the end of `run`, or after an interruption of it: ranking and report of what is done, where the
        last lack something; the exit status.
        """
        if self.graded.unreported:
            self._report()
        return self.graded.exit_status

    def _opened(self) -> tuple[State, Batch | None, tuple[str, ...]]:
        """The batch's own files, and the batch with the fruit that are whole, or why it cannot be graded: it
        may be out of reach for a moment, as one on a network drive.
        """
        batch_state: State = ()
        try:
            batch_state = own_state(BatchFolder(self.root))
            return batch_state, open_batch(self.root, choose=self._whole), ()
        except (BatchRefused, OSError) as fault:
            return batch_state, None, self._sentences(fault)

    def _whole(self, folder: BatchFolder, rows: tuple[FruitRow, ...]) -> tuple[FruitRow, ...]:
        """The fruit that lack nothing, listed or not."""
        every = (*rows, *unlisted_fruit(folder.fruits, rows))
        return self.arrivals.look(folder, every, {name: files for name, (_, files) in self.tried.items()})

    def _chosen(self, batch: Batch, batch_state: State) -> list[str]:
        """Fruit that are whole, at rest and not graded as they are: as many as are worked on at once, the
        first come first. All whose files are as they were graded, but not their row or the batch's own files,
        at once: most are only read again.
        """
        ready = [
            name
            for name, row in batch.row_of.items()
            if self.arrivals.at_rest(name)
            and (
                batch_state != self.compared_state
                or self.tried.get(name) != (row, self.arrivals.of[name].state)
            )
        ]
        again = [
            name
            for name in ready
            if name in self.tried and self.tried[name][1] == self.arrivals.of[name].state
        ]
        return (
            again
            or sorted(ready, key=lambda name: self.arrivals.of[name].last_change_ns)[
                : self.options.grading.jobs
            ]
        )

    def _begin_with_earlier_results(self) -> None:
        """Fruit that earlier runs graded come first, all at once: those that are unchanged are only read."""
        batch_state, batch, _ = self._opened()
        if batch is None:
            return
        records = {row.fruit_id: Results(self.options.out).fruit(row.fruit_id).record for row in batch.rows}
        there = {}
        for name, path in records.items():
            with suppress(OSError):
                if path.is_file():
                    there[name] = path.stat().st_mtime
        if there:
            in_order = sorted(there, key=lambda name: there[name])
            self._grade(batch, batch_state, in_order)

    def _grade(
        self, batch: Batch, batch_state: State, chosen: list[str], *, compare_all: bool = False
    ) -> bool:
        """Grades the chosen fruit; whether they could be. All fruit so far are held against each other anew
        where they are to be (`compare_all`), the batch's own files have changed since they were, or so many
        are chosen (rows that change at once) that it takes no longer; else those alone are graded again that
        have a recording which names one of the chosen. A report follows where it is due, or a chosen one is a
        reference body, by which all others are corrected.
        """
        self.tried = {
            name: row_and_state for name, row_and_state in self.tried.items() if name in batch.row_of
        }
        many = len(chosen) > max(self.options.grading.jobs, len(self.tried) / AS_MANY)
        changed = batch_state != self.compared_state
        states = {name: self.arrivals.of[name].state for name in chosen}
        known = {*self.tried, *chosen, *self.graded.ungraded}
        waiting = sum(name not in known and self.arrivals.at_rest(name) for name in batch.row_of)
        so_far = replace(batch, rows=tuple(row for row in batch.rows if row.fruit_id in known))
        anew = compare_all or many or changed
        try:
            if anew:
                self.graded.grade_all(so_far, chosen, waiting=waiting, changed=changed)
                self.compared_state = batch_state
                for name in chosen:
                    self._first_of_recent(name)
            else:
                self.graded.grade_newcomers(so_far, chosen, waiting=waiting)
        except (BatchRefused, OSError) as fault:
            self.compared_state = None if anew else self.compared_state
            for name in self.graded.ungraded:
                self.tried.pop(name, None)  # as it was before it changed it is graded again, too
            self._refused(fault)
            return False
        for name in chosen:
            self.tried[name] = batch.row_of[name], states[name]
        self._tell(())
        corrects = any(batch.row_of[name].reference for name in chosen)
        if self.graded.report_due or (corrects and self.graded.unreported):
            self._report()
        return True

    def _report(self) -> bool:
        """Ranking and report of the fruit so far, unless they cannot be made, which is told."""
        try:
            self.graded.report()
        except (BatchRefused, OSError) as fault:
            self._refused(fault)
            return False
        return True

    def _refused(self, fault: BatchRefused | OSError) -> None:
        self._tell(self._sentences(fault))

    def _sentences(self, fault: BatchRefused | OSError) -> tuple[str, ...]:
        if isinstance(fault, BatchRefused):
            return tuple(map(str, fault.problems))
        if isinstance(fault, NotWritten):
            return (str(fault),)
        sentence = f"drupe cannot process it ({fault.strerror or fault}) and tries again."
        return (str(Problem(str(fault.filename or self.root), sentence)),)

    def _changed(self, ended: str | None) -> None:
        """The fruit at work or their ranking are others now; `ended`: the fruit that has ended."""
        if ended is not None:
            self._first_of_recent(ended)
        self._tell(())

    def _first_of_recent(self, name: str) -> None:
        """The fruit was graded last, unless its files are those of before: then it is where it was."""
        if name in self.tried and self.tried[name][1] == self.arrivals.of[name].state:
            return
        self.recent = [name, *(fruit_id for fruit_id in self.recent if fruit_id != name)]

    def _name_lacking(self, named: Mapping[str, str]) -> dict[str, str]:
        """Says on the console which fruit lack files though theirs are at rest, where it has not `named` them
        before; all of them, and what each lacks.
        """
        lacking = {name: missing for name, missing in self.arrivals.lacking if self.arrivals.at_rest(name)}
        for name, missing in lacking.items():
            if named.get(name) != missing:
                self._say(f"{name}: not graded yet; missing: {missing}")
        return lacking

    def _say(self, sentence: str) -> None:
        self.console.print(sentence, highlight=False, markup=False, soft_wrap=True)

    def _tell(self, problems: tuple[str, ...]) -> None:
        """Hands over what is to be seen now; problems also go to the console."""
        for problem in problems:
            self._say(problem)
        self.show(
            KioskEntry(
                name=self.root.absolute().name,
                batch=None if self.graded.ranking is None else self.graded.ranking.entry,
                recent=tuple(self.recent),
                working=self.graded.working,
                waiting=self.arrivals.lacking,
                expected=self.arrivals.expected,
                problems=problems,
            )
        )

"""The loop of `drupe watch`: fruit are graded as they arrive, one after the other."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from pipeline.batch.fruits_table import FruitRow, unlisted_fruit
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import Batch, open_batch
from pipeline.batch.records import FruitRecord
from pipeline.exit_status import INTERRUPTED, USAGE
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused
from pipeline.run.batch_run import BatchRun, ReportOptions
from pipeline.run.grading import InterruptedAtWork, grade, grade_newcomers, report_graded
from pipeline.run.incremental_ranking import IncrementalRanking
from pipeline.run.packed_records import PackedRecords
from pipeline.run.reporting import ReportPace
from pipeline.watch.arrivals import Arrival, State, arrival, own_state
from reports.kiosk_page import KioskEntry
from reports.language import ENGLISH

EVERY_S = 0.5
"""Seconds between two looks at the folder, at least. Set by hand: nobody notices less."""
SHARE = 0.05
"""Of the time that looking may take: after a look that took t, t over this is waited."""
TURN = 100
"""Graded fruit whose files one look looks at again, in turn: 0.5 ms each (benchmarks/many_fruit.py watch)."""
AS_MANY = 10
"""Fruit that are only read again in the time in which a single one is taken in: 20 ms and 0.2 s
(benchmarks/many_fruit.py watch)."""
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
    turn: int = 0
    """Of the graded fruit, the first whose folder the last look went into again."""
    expected: int = 0
    """Rows of the table whose fruit have none yet."""
    seen: dict[str, tuple[State, float]] = field(default_factory=dict)
    """Files of each fruit, and since when they are so."""
    tried: dict[str, tuple[FruitRow, State]] = field(default_factory=dict)
    """Row and files of each fruit when it was last graded."""
    recent: list[str] = field(default_factory=list)
    """Fruit in the order in which their files were graded, the last first."""
    own: State | None = None
    """The batch's own files when all fruit were last held against each other; None: none were yet."""
    batch: Batch | None = None
    """The batch as it was last graded."""
    ranking: IncrementalRanking | None = None
    """Of the fruit so far; None: nothing is graded."""
    pace: ReportPace = field(init=False)
    unreported: bool = False
    """Whether fruit were graded since the last report."""
    uncompared: bool = False
    """Whether fruit were graded since all were last held against each other."""
    working: tuple[str, ...] = ()
    """Fruit that are being graded, or were when an interruption came."""
    status: int = 0

    def __post_init__(self) -> None:
        """The pace of reports, by the watch's clock."""
        self.pace = ReportPace(self.clock)

    def run(self) -> int:
        """Watches until nothing new has come for `idle_s`; the exit status of the last report."""
        self._begin_with_earlier_results()
        quiet_since, refused_at = self.clock(), -float("inf")
        before: object = None
        while True:
            began = self.clock()
            own = own_state(BatchFolder(self.root))
            batch, problems = self._opened()
            looked_s = self.clock() - began
            now = own, problems, tuple((name, one.state) for name, one in self.arrivals.items())
            if now != before:
                before, quiet_since, refused_at = now, self.clock(), -float("inf")
                self._tell(problems)
            if self.clock() - refused_at >= AGAIN_S:
                if batch is not None and (chosen := self._chosen(batch, own)):
                    done = self._grade(batch, own, chosen)
                    refused_at = -float("inf") if done else self.clock()
                    quiet_since = self.clock() if done else quiet_since
                    continue
                if batch is not None and self.unreported and self.pace.due():
                    refused_at = -float("inf") if self._report() else self.clock()
                    continue
            waiting = any(self._since(name) < self.options.settle_s for name in self.arrivals)
            idle_s = self.options.idle_s
            if idle_s is not None and not waiting and self.clock() - quiet_since >= idle_s:
                return self._end(batch, own)
            self.sleep(max(EVERY_S, looked_s / SHARE))

    def stop(self) -> int:
        """After an interruption of `run`: ranking and report of what is done; the exit status."""
        at_work = bool(self.working)
        done = self.ranking is None or not (self.unreported or at_work) or self._report()
        if at_work:
            return INTERRUPTED
        return self.status if done else USAGE

    def _opened(self) -> tuple[Batch | None, tuple[str, ...]]:
        """The batch with the fruit that are whole, or why it cannot be graded."""
        try:
            return open_batch(self.root, choose=self._whole), ()
        except BatchRefused as refused:
            return None, tuple(str(problem) for problem in refused.problems)

    def _whole(self, folder: BatchFolder, rows: tuple[FruitRow, ...]) -> tuple[FruitRow, ...]:
        """Looks into the folder of every fruit, listed or not, into those of graded ones in turn; the fruit
        that lack nothing.
        """
        rows = (*rows, *unlisted_fruit(folder.root / "fruits", rows))
        before, self.arrivals = self.arrivals, {}
        graded = [name for name, one in before.items() if self.tried.get(name, ((), ()))[1] == one.state]
        self.turn = self.turn + TURN if self.turn + TURN < len(graded) else 0
        passed_over = {*graded[: self.turn], *graded[self.turn + TURN :]}
        for row in rows:
            if row.fruit_id in passed_over:
                self.arrivals[row.fruit_id] = before[row.fruit_id]
                continue
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

    def _chosen(self, batch: Batch, own: State) -> list[str]:
        """Fruit that are whole, at rest and not graded as they are: as many as are worked on at once, the
        first come first. All whose files are as they were graded, but not their row or the batch's own files,
        at once: most are only read again.
        """
        ready = [
            name
            for name, row in batch.row_of.items()
            if self._since(name) >= self.options.settle_s
            and (own != self.own or self.tried.get(name) != (row, self.arrivals[name].state))
        ]
        again = [
            name for name in ready if name in self.tried and self.tried[name][1] == self.arrivals[name].state
        ]
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

    def _grade(self, batch: Batch, own: State, chosen: list[str], *, compare_all: bool = False) -> bool:
        """Grades the chosen fruit; whether they could be. All fruit so far are held against each other anew
        where they are to be (`compare_all`), the batch's own files have changed since they were, or so many
        are chosen (rows that change at once) that it takes no longer; else those alone are graded again that
        have a recording which names one of the chosen. A report follows where it is due, or a chosen one is a
        reference body, by which all others are corrected.
        """
        self.tried = {name: one for name, one in self.tried.items() if name in batch.row_of}
        many = len(chosen) > max(self.options.jobs, len(self.tried) / AS_MANY)
        states = {name: self.arrivals[name].state for name in chosen}
        known = {*self.tried, *chosen}
        self.batch = replace(batch, rows=tuple(row for row in batch.rows if row.fruit_id in known))
        ranking = None if compare_all or many or own != self.own else self.ranking
        named = [] if ranking is None else ranking.named_by_others(chosen)
        self.working = (*chosen, *(name for name in named if name in self.batch.row_of))
        self._tell(())
        try:
            if ranking is None:
                self._grade_all(self.batch, own, chosen)
            else:
                self._grade_newcomers(self.batch, ranking, self.working)
        except (BatchRefused, NotWritten) as fault:
            self._refused(fault)
            return False
        self.working = ()
        for name in chosen:
            self.tried[name] = batch.row_of[name], states[name]
        self._tell(())
        corrects = any(batch.row_of[name].reference for name in chosen)
        if self.unreported and (corrects or self.pace.due()):
            self._report()
        return True

    def _grade_all(self, batch: Batch, own: State, chosen: list[str]) -> None:
        """All fruit so far as `drupe grade` grades them, with ranking and report."""
        records = PackedRecords()
        try:
            self.status, entry = grade(
                self.root,
                self.options.out,
                jobs=self.options.jobs,
                time_limit_s=self.options.time_limit_s,
                console=self.console,
                screen=self.options.screen,
                options=ReportOptions(language=self.options.language),
                opened=batch,
                retried=chosen,
                records=records,
            )
        except InterruptedAtWork:
            self.working = tuple(name for name in batch.row_of if name not in records)
            self.status, self.ranking = INTERRUPTED, None  # what was done is reported
            raise
        except KeyboardInterrupt:
            if self.ranking is not None:
                self.ranking.records.update(records)
                self.working = tuple(name for name in self.working if name not in records)
                self.unreported = True
            raise
        self.ranking, self.own = IncrementalRanking(records, entry), own
        self.unreported = self.uncompared = False
        for name in chosen:
            self._first_of_recent(name)

    def _grade_newcomers(self, batch: Batch, ranking: IncrementalRanking, taken: tuple[str, ...]) -> None:
        """The taken fruit alone."""
        for gone in ranking.records.keys() - batch.row_of.keys():
            del ranking.records[gone]

        def ended(run: BatchRun, record: FruitRecord) -> None:
            ranking.add(run, record)
            self.unreported = self.uncompared = True
            self._first_of_recent(record.fruit_id)
            self.working = tuple(name for name in self.working if name != record.fruit_id)
            self._tell(())

        grade_newcomers(
            batch,
            self.options.out,
            taken,
            ranking.records,
            jobs=self.options.jobs,
            time_limit_s=self.options.time_limit_s,
            console=self.console,
            screen=self.options.screen,
            ended=ended,
        )

    def _report(self) -> bool:
        """Ranking and report of the fruit so far, unless they cannot be made, which is told. Fruit that could
        not be graded again make it that of an interrupted run.
        """
        if self.batch is None or self.ranking is None:
            return False
        records = self.ranking.records
        expected = {*records, *self.tried, *self.working}
        rows = tuple(row for row in self.batch.rows if row.fruit_id in expected)
        try:
            with self.pace.reporting():
                done = report_graded(
                    replace(self.batch, rows=rows),
                    self.options.out,
                    records,
                    screen=self.options.screen,
                    options=ReportOptions(language=self.options.language),
                )
        except (BatchRefused, NotWritten) as fault:
            self._refused(fault)
            return False
        if done is None:
            self.status = INTERRUPTED
        else:
            self.status, self.ranking.entry = done
        self.unreported = False
        self._tell(())
        return True

    def _end(self, batch: Batch | None, own: State) -> int:
        """All fruit held against each other once more, where some have come since they were; the exit
        status.
        """
        if batch is not None and self.uncompared:
            done = self._grade(batch, own, [], compare_all=True)
        else:
            done = not self.unreported or self._report()
        return self.status if done else USAGE

    def _refused(self, fault: BatchRefused | NotWritten) -> None:
        """Tells why nothing could be graded or written."""
        self.working = ()
        problems = fault.problems if isinstance(fault, BatchRefused) else [fault]
        self._tell(tuple(str(problem) for problem in problems))

    def _first_of_recent(self, name: str) -> None:
        """The fruit was graded last, unless its files are those of before: then it is where it was."""
        if name in self.tried and self.tried[name][1] == self.arrivals[name].state:
            return
        self.recent = [name, *(one for one in self.recent if one != name)]

    def _tell(self, problems: tuple[str, ...]) -> None:
        """Hands over what is to be seen now; problems also go to the console."""
        for problem in problems:
            self.console.print(problem, highlight=False, markup=False)
        self.show(
            KioskEntry(
                name=self.root.absolute().name,
                batch=None if self.ranking is None else self.ranking.entry,
                recent=tuple(self.recent),
                working=self.working,
                waiting=tuple((name, one.missing) for name, one in self.arrivals.items() if one.missing),
                expected=self.expected,
                problems=problems,
            )
        )

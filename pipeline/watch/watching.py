"""The loop of `drupe watch`: grades fruit as their files arrive."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import Batch, open_batch, unlisted_fruit
from pipeline.batch.records import FruitRecord
from pipeline.batch.write_guard import results_lock
from pipeline.exit_status import DONE, INTERRUPTED, USAGE
from pipeline.files.whole_file import NotWritten
from pipeline.fruit.recording_owner import copies_doubted
from pipeline.problem import BatchRefused, Problem
from pipeline.ranking.reference_temperature import compared
from pipeline.run.batch_run import BatchRun, GradeOptions
from pipeline.run.grading import begun, grade_queue, placed, say_begun
from pipeline.run.progress import say
from pipeline.run.reporting import ReportPace, entry_of, outcomes_of, report_of_records
from pipeline.watch.arrivals import Arrivals, State, own_state
from reports.entries import BatchEntry, FruitEntry
from reports.kiosk_page import KioskEntry

EVERY_S = 0.5
"""Least seconds between two scans of the folder. Set by hand: nobody notices less."""
SHARE = 0.05
"""Largest share of time for scans: after a scan of t seconds the loop waits at least t / SHARE."""
AGAIN_S = 10.0
"""Seconds until drupe tries a refused batch again even without changes: the cause may lie elsewhere (another
run that writes there, a full disk)."""


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Options of a watch. `out`: results folder; `grading`: as for `drupe grade`. `settle_s`: seconds without
    a change until a fruit's files are at rest; `idle_s`: seconds without news until the end (None: never).
    """

    out: Path
    grading: GradeOptions
    settle_s: float
    idle_s: float | None = None


@dataclass(kw_only=True)
class BatchWatch:
    """The state of a watched batch between two scans.

    `show` receives each new content of the page; `clock` in seconds. The loop of `drupe grade` grades the
    fruit. The page shows each fruit once it ends, among those of the last report. Ranking and report of all
    fruit follow at intervals that keep their cost near 1 % of the time.
    """

    root: Path
    options: WatchOptions
    console: Console
    show: Callable[[KioskEntry], None]
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    records: dict[str, FruitRecord] = field(default_factory=dict)
    """Records of the finished fruit."""
    graded: dict[str, tuple[FruitRow, State]] = field(default_factory=dict)
    """Row and files of each fruit when it was last graded."""
    batch_files: State | None = None
    """The batch's own files when its fruit were graded."""
    batch: Batch | None = None
    """The batch, with its finished fruit and those in work."""
    working: tuple[str, ...] = ()
    """Fruit in work, or in work when Ctrl-C interrupted them."""
    recent: dict[str, State] = field(default_factory=dict)
    """Fruit in the order of grading, the last at the end, with the state of the graded files."""
    entry: BatchEntry | None = None
    """The entry of the last report, with the fruit that have ended since."""
    unreported: bool = False
    """Whether the last report lacks a fruit or a verdict."""
    refused: bool = False
    """Whether the last grading or report was refused."""
    status: int = DONE
    """Exit status of the last report."""
    arrivals: Arrivals = field(init=False)
    """The files of the fruit at the last scan."""
    pace: ReportPace = field(init=False)

    def __post_init__(self) -> None:
        """Sets the parts that need the options and the clock."""
        self.arrivals = Arrivals(settle_s=self.options.settle_s, clock=self.clock)
        self.pace = ReportPace(self.clock)

    @property
    def reported(self) -> BatchEntry | None:
        """The entry of the last report; None if it is incomplete or missing."""
        return None if self.unreported else self.entry

    def judged(self) -> None:
        """Notes a new verdict, which the last report lacks."""
        self.unreported = self.unreported or self.batch is not None

    def run(self) -> int:
        """Watches until `idle_s` seconds pass without news; returns the exit status as `stop` does. After a
        fault it writes ranking and report of the finished fruit, and raises the fault again.
        """
        try:
            return self._run()
        except Exception:
            with suppress(Exception):  # the first fault matters more
                self.stop()
            raise

    def _run(self) -> int:
        quiet_since, refused_at = self.clock(), -float("inf")
        before: object = None
        named: dict[str, str] = {}
        while True:
            began = self.clock()
            batch_files, batch, problems = self._opened()
            looked_s = self.clock() - began
            states = tuple((name, arrival.state) for name, arrival in self.arrivals.of.items())
            if (batch_files, problems, states) != before:
                before, quiet_since, refused_at = (batch_files, problems, states), self.clock(), -float("inf")
                self._tell(problems)
            named = self._name_lacking(named)
            if batch is not None and self.clock() - refused_at >= AGAIN_S:
                self._forget_changed(batch, batch_files)
                chosen = self._chosen(batch)
                if chosen or (self.unreported and self.pace.due()):
                    done = self._grade(batch, batch_files, chosen) if chosen else self._report()
                    refused_at = -float("inf") if done else self.clock()
                    quiet_since = self.clock() if done and chosen else quiet_since
                    continue
            idle_s, coming = self.options.idle_s, not all(map(self.arrivals.at_rest, self.arrivals.of))
            if idle_s is not None and not coming and self.clock() - quiet_since >= idle_s:
                return self.stop()
            self.sleep(max(EVERY_S, looked_s / SHARE))

    def stop(self) -> int:
        """Ends `run`, also after an interruption: writes ranking and report if the last are incomplete.

        Returns the exit status of the last report, but INTERRUPTED if fruit are unfinished, and USAGE if the
        report or present fruit were refused.
        """
        if self.unreported or self.working:
            self._report()
        if self.working:
            return INTERRUPTED
        return USAGE if self.refused and self.status != INTERRUPTED else self.status

    def _opened(self) -> tuple[State, Batch | None, tuple[str, ...]]:
        """The state of the batch's own files, the batch with its complete fruit, and problems. The batch is
        None if it is refused or out of reach for a moment, for example on a network drive.
        """
        batch_files: State = ()
        try:
            batch_files = own_state(BatchFolder(self.root))
            return batch_files, open_batch(self.root, choose=self._whole), ()
        except (BatchRefused, OSError) as fault:
            return batch_files, None, self._sentences(fault)

    def _whole(self, folder: BatchFolder, rows: tuple[FruitRow, ...]) -> tuple[FruitRow, ...]:
        every = (*rows, *unlisted_fruit(folder, rows))
        return self.arrivals.look(folder, every)

    def _forget_changed(self, batch: Batch, batch_files: State) -> None:
        """Forgets fruit that are gone or incomplete, or whose row, files or settings have changed since."""
        for name, (row, state) in [*self.graded.items()]:
            if name not in batch.row_of:
                del self.graded[name]
                self.records.pop(name, None)
                self.unreported = True
            elif batch_files != self.batch_files or (
                (row, state) != (batch.row_of[name], self.arrivals.of[name].state)
                and self.arrivals.at_rest(name)
            ):
                del self.graded[name]
        self.refused = self.refused and not all(name in self.graded for name in batch.row_of)
        if self.batch is not None:
            rows = tuple(row for row in self.batch.rows if row.fruit_id in batch.row_of)
            self.batch = replace(self.batch, rows=rows)

    def _chosen(self, batch: Batch) -> list[str]:
        """The next fruit to grade, of those that are complete, at rest and not yet graded in this state: all
        with a record together, because drupe only reads most records; else the earliest, one per job.
        """
        ready = [name for name in batch.row_of if name not in self.graded and self.arrivals.at_rest(name)]
        results = Results(self.options.out)
        again = [name for name in ready if results.fruit(name).record.is_file()]
        newest = sorted(ready, key=lambda name: self.arrivals.of[name].last_change_ns)
        return again or newest[: self.options.grading.jobs]

    def _grade(self, batch: Batch, batch_files: State, chosen: list[str]) -> bool:
        """Grades the chosen fruit; returns False if this is refused. A report follows if it is due, if drupe
        only read several records, and after a reference body, which corrects all other fruit.
        """
        known = {*self.records, *chosen}
        so_far = replace(batch, rows=tuple(row for row in batch.rows if row.fruit_id in known))
        states = {name: self.arrivals.of[name].state for name in chosen}
        waiting = sum(name not in known and self.arrivals.at_rest(name) for name in batch.row_of)
        before = () if self.batch is None else self.batch.row_of
        self.batch, self.working = so_far, tuple(chosen)
        try:
            for name in chosen:
                self.unreported = self.records.pop(name, None) is not None or self.unreported
            self._tell(())
            run = self._placed(so_far, hashed=not self.records)
            with results_lock(self.options.out):
                run.require_ours(chosen)
                queue = begun(run, chosen, self.records, console=self.console)
                if self.batch_files is None:
                    say_begun(queue)
                for name in queue.kept:
                    self._ended(run, self.records[name], states[name], shown=len(chosen) == 1)
                grade_queue(
                    queue,
                    lambda record: self._ended(run, record, states[record.fruit_id]),
                    waiting=waiting,
                )
        except KeyboardInterrupt:
            self.working = tuple(name for name in chosen if name not in self.records)
            raise
        except (BatchRefused, OSError) as fault:
            kept = {*before, *self.records}
            rows = tuple(row for row in so_far.rows if row.fruit_id in kept)
            self.batch, self.working = replace(so_far, rows=rows), ()
            return self._refuse(fault)
        self.batch_files, self.refused = batch_files, False
        corrects = any(batch.row_of[name].reference for name in chosen)
        if self.pace.due() or corrects or len(queue.kept) > 1:
            self._report()
        else:
            self._tell(())
        return True

    def _placed(self, batch: Batch, *, hashed: bool) -> BatchRun:
        began = datetime.now(UTC), time.monotonic()
        return placed(batch, self.options.out, self.options.grading, began=began, hashed=hashed)

    def _ended(self, run: BatchRun, record: FruitRecord, state: State, *, shown: bool = True) -> None:
        """Stores an ended fruit, and shows it among those of the last report unless `shown` is false."""
        name = record.fruit_id
        self.graded[name] = run.batch.row_of[name], state
        self.working = tuple(fruit_id for fruit_id in self.working if fruit_id != name)
        self.unreported = True
        if self.recent.get(name) != state:
            self.recent.pop(name, None)
            self.recent[name] = state
        if shown and self.entry is not None:
            self.entry = self._with_newcomer(run, self.entry, record)
            self._tell(())

    def _with_newcomer(self, run: BatchRun, entry: BatchEntry, record: FruitRecord) -> BatchEntry:
        """The last report's entry with a new fruit: its E, corrected by the reference bodies so far, and its
        rank. The next report updates the ranks of the others and the probability of this rank.
        """
        bodies = [
            self.records[row.fruit_id]
            for row in run.batch.rows
            if row.reference and row.fruit_id in self.records and row.fruit_id != record.fruit_id
        ]
        related = copies_doubted([*bodies, record], run.batch.folder)
        in_order, finding = compared(related, run.batch.settings)
        alone = [measured for measured in in_order if measured.fruit_id == record.fruit_id]
        (fruit,) = entry_of(run)(alone, exit_status=None, finding=finding).fruits
        others = [
            other
            for other in entry.fruits
            if other.fruit_id != fruit.fruit_id and other.fruit_id in run.batch.row_of
        ]
        return replace(entry, fruits=(*others, _ranked(fruit, others)))

    def _report(self) -> bool:
        """Writes ranking and report of the fruit so far; returns False and shows the problem if refused."""
        if self.batch is None or not self.records:
            return True
        try:
            run = self._placed(self.batch, hashed=True)
            with results_lock(self.options.out), self.pace.reporting():
                run.require_ours()
                self.status, entry = report_of_records(run, self.records)
                if self.status == INTERRUPTED:
                    run.write_provenance(outcomes_of(self.records), self.status)
        except (BatchRefused, OSError) as fault:
            return self._refuse(fault)
        self.unreported, self.refused = False, False
        self.entry = entry or self.entry
        self._tell(())
        return True

    def _refuse(self, fault: BatchRefused | OSError) -> bool:
        self.refused = True
        self._tell(self._sentences(fault))
        return False

    def _sentences(self, fault: BatchRefused | OSError) -> tuple[str, ...]:
        if isinstance(fault, BatchRefused):
            return tuple(map(str, fault.problems))
        if isinstance(fault, NotWritten):
            return (str(fault),)
        sentence = f"drupe cannot process it ({fault.strerror or fault}) and tries again."
        return (str(Problem(str(fault.filename or self.root), sentence)),)

    def _name_lacking(self, named: Mapping[str, str]) -> dict[str, str]:
        """Prints the incomplete fruit whose files are at rest, unless `named` has them. Returns all of them,
        with the inputs that they lack.
        """
        lacking = {name: missing for name, missing in self.arrivals.lacking if self.arrivals.at_rest(name)}
        for name, missing in lacking.items():
            if named.get(name) != missing:
                say(self.console, f"{name}: not graded yet; missing: {missing}")
        return lacking

    def _tell(self, problems: tuple[str, ...]) -> None:
        """Passes the present entry to `show`; prints problems on the console too."""
        for problem in problems:
            say(self.console, problem)
        self.show(
            KioskEntry(
                name=self.root.absolute().name,
                batch=self.entry,
                recent=tuple(reversed(self.recent)),
                working=self.working,
                waiting=self.arrivals.lacking,
                expected=self.arrivals.expected,
                problems=problems,
            )
        )


def _ranked(fruit: FruitEntry, others: list[FruitEntry]) -> FruitEntry:
    """The fruit with its rank among the others, without probabilities; they follow with the next report."""
    if fruit.rank is None or fruit.E_MPa is None:
        return fruit
    softer = sum(
        other.E_MPa < fruit.E_MPa for other in others if other.rank is not None and other.E_MPa is not None
    )
    return replace(
        fruit, rank=1 + softer, rank_probability=None, rank_low=None, rank_high=None, p_softer_than_next=None
    )

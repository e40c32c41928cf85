"""A run that takes the fruit of a batch as they come: their records, their ranking, and what is written."""

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from pipeline.batch.opening import Batch
from pipeline.batch.records import FruitRecord
from pipeline.exit_status import DONE, INTERRUPTED, USAGE
from pipeline.problem import BatchRefused
from pipeline.run.batch_run import BatchRun, GradeOptions
from pipeline.run.grading import InterruptedAtWork, grade, grade_newcomers, report_graded
from pipeline.run.incremental_ranking import IncrementalRanking
from pipeline.run.packed_records import PackedRecords
from pipeline.run.reporting import ReportPace
from reports.entries import BatchEntry


@dataclass(kw_only=True)
class IncrementalRun:
    """Fruit graded into `out` as they come, of which every moment has records, a ranking and an exit status
    that agree, after Ctrl-C and a refusal too.

    `records` are those of all fruit of `batch`, but for `working` and such as could not be graded again;
    `ranking` is of the same records. `tell` is told when `working` or the ranking have changed, with the
    fruit that has ended. `clock` in seconds.

    The methods raise BatchRefused and NotWritten as `grade` does, and any other OSError where files are
    out of reach. After Ctrl-C only `report` may be called.
    """

    out: Path
    options: GradeOptions
    console: Console
    tell: Callable[[str | None], None]
    clock: Callable[[], float] = time.monotonic
    batch: Batch | None = None
    """As it was when its fruit were graded; None: nothing is."""
    records: PackedRecords = field(default_factory=PackedRecords)
    ranking: IncrementalRanking | None = None
    """None: the fruit were not held against each other yet."""
    working: tuple[str, ...] = ()
    """Fruit that are being graded, or were when Ctrl-C came."""
    unreported: bool = False
    """Whether the last report lacks something."""
    uncompared: bool = False
    """Whether fruit were graded since all were last held against each other."""
    refused: frozenset[str] = frozenset()
    """Fruit that were refused when they were last to be graded, and are still in the batch."""
    status: int = DONE
    """Exit status of the last report."""
    pace: ReportPace = field(init=False)

    def __post_init__(self) -> None:
        """The pace of reports, by the run's clock."""
        self.pace = ReportPace(self.clock)

    @property
    def report_due(self) -> bool:
        """Whether a report is to be made now."""
        return self.unreported and self.pace.due()

    @property
    def reported(self) -> BatchEntry | None:
        """What the last report says; None where it lacks something or there is none."""
        return None if self.ranking is None or self.unreported else self.ranking.entry

    @property
    def ungraded(self) -> tuple[str, ...]:
        """Fruit of the batch without a record: those at work, and such as could not be graded again."""
        return () if self.batch is None else tuple(n for n in self.batch.row_of if n not in self.records)

    @property
    def exit_status(self) -> int:
        """Of a run that ends now: that of its last report, but INTERRUPTED where fruit are unfinished, and
        USAGE where the report, or fruit that are still there, were refused.
        """
        if self.working:
            return INTERRUPTED
        refused = self.unreported or (bool(self.refused) and self.status != INTERRUPTED)
        return USAGE if refused else self.status

    def judged(self) -> None:
        """Somebody gave a verdict, which the last report lacks."""
        self.unreported = self.unreported or self.batch is not None

    def looked(self, batch: Batch) -> None:
        """`batch` is what is there now: fruit that could not be graded are forgotten where they are gone."""
        self.refused = self.refused.intersection(batch.row_of)
        gone = set(self.ungraded) - batch.row_of.keys()
        if self.batch is not None and gone:
            rows = tuple(row for row in self.batch.rows if row.fruit_id not in gone)
            self.batch = replace(self.batch, rows=rows)

    def grade_all(self, batch: Batch, retried: Collection[str], *, waiting: int, changed: bool) -> None:
        """All fruit of `batch`, held against each other, with ranking and report, as `drupe grade` does.

        `retried` are at work; of the others, those are too whose record does not hold. `changed`: whether the
        batch's own files are others than those of `records`, which hold for no fruit then until it is read.
        `waiting`: fruit that are graded after these. Where it raises after fruit were graded or read, those
        alone have records, as they alone are in the ranking that was written.
        """
        records = PackedRecords()
        try:
            self._begins(retried)
            self.status, entry = grade(
                batch.folder.root,
                self.out,
                self.options,
                console=self.console,
                opened=batch,
                retried=retried,
                say_unchanged=self.batch is None,
                records=records,
                waiting=waiting,
            )
            ranking = IncrementalRanking(records, entry)
        except (BatchRefused, OSError):
            self.working, self.refused = (), frozenset(batch.row_of.keys() - records.keys())
            if records:
                self.batch, self.records, self.unreported = batch, records, True
            raise
        except KeyboardInterrupt as stopped:
            self._interrupted(batch, records, retried, changed=changed, stopped=stopped)
            raise
        self.batch, self.records, self.ranking = batch, records, ranking
        self.working, self.unreported, self.uncompared, self.refused = (), False, False, frozenset()

    def _interrupted(
        self,
        batch: Batch,
        records: PackedRecords,
        retried: Collection[str],
        *,
        changed: bool,
        stopped: KeyboardInterrupt,
    ) -> None:
        """Ctrl-C came while all fruit were held against each other, of which `records` are done. Results of
        earlier runs that were not all read yet are left as they are.
        """
        written = isinstance(stopped, InterruptedAtWork)
        first = self.batch is None
        if changed or written:
            self.working = tuple(name for name in batch.row_of if name not in records)
            self.records, self.ranking = records, None
        else:
            self.working = tuple(name for name in retried if name not in records)
            self.records.update(records)
            self._forget(self.working)
        self.batch = batch
        self.unreported = not written and not (first and self.working)
        self.status = INTERRUPTED if written else self.status

    def grade_newcomers(self, batch: Batch, newcomers: Collection[str], *, waiting: int) -> None:
        """Those alone, and fruit that have a recording which names one of them; each is ranked as it ends.

        `batch`: with the fruit so far, which `grade_all` has graded with the same files of the batch's own.
        Where newcomers are refused, fruit that name them keep their records; those of newcomers that were
        graded before are forgotten, as their files are others now.
        """
        if self.batch is None or self.ranking is None or self.ranking.records is not self.records:
            raise ValueError("the fruit so far were not graded by grade_all")
        ranking, before = self.ranking, self.batch.row_of
        named = [name for name in ranking.named_by_others(newcomers) if name in batch.row_of]
        taken = (*newcomers, *named)
        held = {name: self.records[name] for name in named if name in self.records}

        def ended(run: BatchRun, record: FruitRecord) -> None:
            ranking.add(run, record)
            self.unreported = self.uncompared = True
            self.working = tuple(name for name in self.working if name != record.fruit_id)
            self.tell(record.fruit_id)

        self.batch, self.refused, forgotten = batch, frozenset(), False
        try:
            self._begins(taken)
            self._forget({*taken, *(self.records.keys() - batch.row_of.keys())})
            forgotten = True
            grade_newcomers(
                batch,
                self.out,
                taken,
                self.records,
                self.options,
                console=self.console,
                ended=ended,
                waiting=waiting,
            )
        except (BatchRefused, OSError):
            refused = frozenset(newcomers) - self.records.keys()
            if len(refused) == len(newcomers):
                self.records.update((name, held[name]) for name in held.keys() - self.records.keys())
            rows = tuple(row for row in batch.rows if row.fruit_id in before or row.fruit_id in self.records)
            self.batch = replace(batch, rows=rows)
            self.working, self.refused = (), refused
            self.unreported = self.unreported or bool(self.ungraded)
            raise
        except KeyboardInterrupt:
            if not forgotten:
                self._forget(taken)
            self.working = tuple(name for name in taken if name not in self.records)
            self.unreported = True
            raise

    def report(self) -> None:
        """Ranking and report of the fruit so far: those of an interrupted run, where some have no record."""
        if self.batch is None:
            return
        with self.pace.reporting():
            self.status, entry = report_graded(self.batch, self.out, self.records, self.options)
        self.unreported = False
        if entry is not None:
            if self.ranking is None or self.ranking.records is not self.records:
                self.ranking = IncrementalRanking(self.records, entry)
            self.ranking.entry = entry
        self.tell(None)

    def _begins(self, fruit: Collection[str]) -> None:
        self.working = tuple(fruit)
        self.tell(None)

    def _forget(self, fruit: Collection[str]) -> None:
        for name in fruit:
            self.records.pop(name, None)

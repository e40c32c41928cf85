"""Which fruit of a batch a run works on: those whose record of an earlier run does not hold, each looked at
when its turn comes, so that the first of thousands need not wait for the last.
"""

from collections import deque
from collections.abc import Collection, Iterator
from typing import NamedTuple

from rich.console import Console

from pipeline.batch.batch_fruits import BatchFruits
from pipeline.batch.layout import FruitFolder
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import FruitRecord, read_record
from pipeline.batch.task import FruitTask, batch_fruits, fruit_task
from pipeline.run.batch_run import BatchRun
from pipeline.run.checking import ImplausibleNumbers, implausible_batch
from pipeline.run.fruit_records import ended_record, kept_record
from pipeline.run.packed_records import PackedRecords

GRADED_ALL_THE_SAME = "drupe grades the fruit anyway (--force)."


class WaitingFruit(NamedTuple):
    """A fruit that is to be worked on."""

    fruit_id: str
    folder: FruitFolder


class FruitQueue:
    """The fruit of a run: `records` of those that are done, as many from an earlier run as `kept` says, and
    `todo` of the others, which it yields with their tasks. One whose numbers are not plausible gets its
    record when it is reached, and is one of `refused`.

    `retried`: fruit that are tried again where an earlier run ended them for a cause that may pass; None:
    all. `fruits`: those that are looked at; None: all of the run. `records`: where records are put; None:
    nowhere else.
    """

    def __init__(
        self,
        run: BatchRun,
        console: Console,
        retried: Collection[str] | None,
        *,
        fruits: Collection[str] | None = None,
        records: PackedRecords | None = None,
    ) -> None:
        self._run, self._console, self._retried = run, console, retried
        self._among: BatchFruits = batch_fruits(run.batch, run.results)
        self._numbers = ImplausibleNumbers(run.batch)
        self._going: dict[str, FruitTask] = {}
        self._forced: dict[str, list[str]] = (
            {name: [*said] for name, said in implausible_batch(run.batch).items()} if run.force else {}
        )
        self.records = PackedRecords() if records is None else records
        self.refused: deque[FruitRecord] = deque()
        self.todo: list[WaitingFruit] = []
        refused: list[str] = []
        looked_at = run.batch.row_of if fruits is None else fruits
        for fruit_id in looked_at:
            before = read_record(run.results.fruit(fruit_id).record)
            if before is None or not self._holds(fruit_id, before, refused):
                self.todo.append(WaitingFruit(fruit_id, run.batch.folder.fruit(fruit_id)))
        self.kept = len(looked_at) - len(self.todo) - len(refused)

    def _holds(self, fruit_id: str, before: FruitRecord, refused: list[str]) -> bool:
        """Whether an earlier run's record holds, or the fruit's numbers are refused; it is in `records`."""
        task = self._task(fruit_id)
        if before.key != task.key:
            return False
        size = before.mesh.box_mm if before.graded and before.mesh is not None else None
        sentence = self._numbers.said(self._run.batch.row_of[fruit_id], box_mm=size)
        if sentence and not self._run.force:
            self.records[fruit_id] = ended_record(task, Outcome.IMPLAUSIBLE_INPUT, sentence)
            refused.append(fruit_id)
            return True
        kept = kept_record(task, before, self._among, retried=self._retried)
        if kept is None:
            return False
        if sentence:
            self._force(fruit_id, sentence)
        self.records[fruit_id] = kept
        return True

    def __iter__(self) -> Iterator[tuple[str, FruitTask]]:
        """Fruit and tasks in their order."""
        for fruit_id, _ in self.todo:
            task = self._task(fruit_id)
            if sentence := self._numbers.said(self._run.batch.row_of[fruit_id]):
                if not self._run.force:
                    self.records[fruit_id] = record = ended_record(task, Outcome.IMPLAUSIBLE_INPUT, sentence)
                    self.refused.append(record)
                    continue
                self._force(fruit_id, sentence)
            self._going[fruit_id] = task
            yield fruit_id, task

    def ended(self, fruit_id: str) -> FruitTask:
        """The task of a fruit that has ended."""
        return self._going.pop(fruit_id)

    def forced(self, fruit_id: str) -> list[str]:
        """What a fruit is graded in spite of, as sentences for its doubts."""
        return [f"{sentence} {GRADED_ALL_THE_SAME}" for sentence in self._forced.get(fruit_id, ())]

    def _force(self, fruit_id: str, sentence: str) -> None:
        self._console.print(
            f"{fruit_id}: {sentence} drupe grades the fruit anyway.", highlight=False, markup=False
        )
        self._forced.setdefault(fruit_id, []).append(sentence)

    def _task(self, fruit_id: str) -> FruitTask:
        run = self._run
        return fruit_task(run.batch, fruit_id, run.results, screen=run.screen, among=self._among)

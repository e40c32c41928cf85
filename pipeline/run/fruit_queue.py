"""Which fruit of a batch a run works on: those whose record of an earlier run does not hold, each looked at
when its turn comes, so that the first of thousands need not wait for the last.
"""

from collections import deque
from collections.abc import Collection, Iterator

from rich.console import Console

from pipeline.batch.layout import FruitFolder
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import FruitRecord, read_record
from pipeline.batch.task import FruitTask, fruit_task
from pipeline.run.batch_run import BatchRun
from pipeline.run.checking import ImplausibleNumbers, implausible_batch
from pipeline.run.fruit_records import ended_record, kept_record
from pipeline.run.packed_records import PackedRecords

GRADED_ALL_THE_SAME = "drupe grades the fruit anyway (--force)."


class FruitQueue:
    """The `chosen` fruit of a run: `records` gets those of an earlier run that hold (`kept`), and `todo` are
    the others, which it yields with their tasks. One whose numbers are not plausible gets its record when it
    is reached, and is one of `refused`.
    """

    def __init__(
        self, run: BatchRun, chosen: Collection[str], records: PackedRecords, console: Console
    ) -> None:
        self._run, self._console = run, console
        self._numbers = ImplausibleNumbers(run.batch)
        self._going: dict[str, FruitTask] = {}
        self._forced: dict[str, list[str]] = (
            {name: [*said] for name, said in implausible_batch(run.batch).items()} if run.force else {}
        )
        self.records = records
        self.refused: deque[FruitRecord] = deque()
        self.todo: dict[str, FruitFolder] = {}
        self.kept: list[str] = []
        for fruit_id in chosen:
            before = read_record(run.results.fruit(fruit_id).record)
            if before is not None and self._holds(fruit_id, before):
                self.kept.append(fruit_id)
            else:
                self.todo[fruit_id] = run.batch.folder.fruit(fruit_id)

    def _holds(self, fruit_id: str, before: FruitRecord) -> bool:
        """Whether an earlier run's record holds; it is in `records` then."""
        task = self._task(fruit_id)
        kept = kept_record(task, before, self._run.batch.row_of)
        if kept is None:
            return False
        size = kept.mesh.box_mm if kept.graded and kept.mesh is not None else None
        if sentence := self._numbers.said(self._run.batch.row_of[fruit_id], box_mm=size):
            if not self._run.force:
                return False
            self._force(fruit_id, sentence)
        self.records[fruit_id] = kept
        return True

    def __iter__(self) -> Iterator[tuple[str, FruitTask]]:
        """Fruit and tasks in their order."""
        for fruit_id in self.todo:
            task = self._task(fruit_id)
            if sentence := self._numbers.said(self._run.batch.row_of[fruit_id]):
                if not self._run.force:
                    record = ended_record(task, Outcome.IMPLAUSIBLE_INPUT, sentence)
                    self.records[fruit_id] = record
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
        return fruit_task(run.batch, fruit_id, run.results, screen=run.screen)

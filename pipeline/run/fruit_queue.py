"""The fruit of a batch that a run grades: those without a valid record of an earlier run. Fruit without a
record are inspected when their turn comes, so that the first of thousands need not wait for the last.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress

from rich.console import Console

from pipeline.batch.layout import FruitFolder
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import FruitRecord, read_record, write_changed, write_record
from pipeline.batch.task import FruitTask, fruit_task
from pipeline.files.whole_file import NotWritten
from pipeline.fruit.recording_owner import named_row
from pipeline.run.batch_run import BatchRun
from pipeline.run.checking import implausible, implausible_batch
from pipeline.run.progress import say
from pipeline.run.scheduling import Finished

GRADED_ALL_THE_SAME = "drupe grades the fruit anyway (--force)."
RETRIED = frozenset(
    outcome.code
    for outcome in (
        Outcome.CRASHED,
        Outcome.TIMED_OUT,
        Outcome.OUT_OF_MEMORY,
        Outcome.NOT_WRITTEN,
        Outcome.INTERNAL,
        Outcome.IMPLAUSIBLE_INPUT,
    )
)
"""Outcomes that may change on another attempt, or that do not depend on the fruit's own files."""


class FruitQueue:
    """The `chosen` fruit of a run. `records` gets the valid records of an earlier run (`kept`). `todo` are
    the others, which it yields with their tasks. A fruit with implausible numbers ends when its turn comes,
    without a process.
    """

    def __init__(
        self, run: BatchRun, chosen: Collection[str], records: dict[str, FruitRecord], console: Console
    ) -> None:
        self.run, self.console, self.records = run, console, records
        self._going: dict[str, FruitTask] = {}
        self._forced: dict[str, list[str]] = implausible_batch(run.batch) if run.options.force else {}
        self.todo: dict[str, FruitFolder] = {}
        self.kept: list[str] = []
        for fruit_id in chosen:
            before = read_record(run.results.fruit(fruit_id).record)
            if before is not None and self._holds(fruit_id, before):
                self.kept.append(fruit_id)
            else:
                self.todo[fruit_id] = run.batch.folder.fruit(fruit_id)

    def _holds(self, fruit_id: str, before: FruitRecord) -> bool:
        """Whether an earlier run's record is valid; if so, adds it to `records`."""
        kept = kept_record(self._task(fruit_id), before, self.run.batch.row_of)
        if kept is None:
            return False
        size = kept.mesh.box_mm if kept.graded and kept.mesh is not None else None
        if self._implausible(fruit_id, box_mm=size):
            return False
        self.records[fruit_id] = kept
        return True

    def __iter__(self) -> Iterator[tuple[str, FruitTask | Finished]]:
        for fruit_id in self.todo:
            task = self._going[fruit_id] = self._task(fruit_id)
            if sentence := self._implausible(fruit_id):
                record = ended_record(task, Outcome.IMPLAUSIBLE_INPUT, sentence)
                yield fruit_id, Finished(fruit_id, record)
            else:
                yield fruit_id, task

    def ended(self, fruit_id: str) -> FruitTask:
        """The task of a fruit that has ended."""
        return self._going.pop(fruit_id)

    def forced(self, fruit_id: str) -> list[str]:
        """Sentences on implausible numbers with which --force grades a fruit, for its doubts."""
        return [f"{sentence} {GRADED_ALL_THE_SAME}" for sentence in self._forced.get(fruit_id, ())]

    def _implausible(self, fruit_id: str, *, box_mm: Sequence[float] | None = None) -> str:
        """Why drupe refuses the fruit; empty if its numbers are plausible, or forced, which it prints."""
        batch = self.run.batch
        sentence = implausible(batch, batch.row_of[fruit_id], box_mm=box_mm)
        if not sentence or not self.run.options.force:
            return sentence
        say(self.console, f"{fruit_id}: {sentence} drupe grades the fruit anyway.")
        self._forced.setdefault(fruit_id, []).append(sentence)
        return ""

    def _task(self, fruit_id: str) -> FruitTask:
        return fruit_task(self.run.batch, fruit_id, self.run.results, screen=self.run.options.screen)


def ended_record(task: FruitTask, outcome: Outcome, particulars: str) -> FruitRecord:
    """Writes and returns the record of a fruit whose process wrote none; ignores a failure to write."""
    record = FruitRecord(
        fruit_id=task.fruit_id,
        outcome=outcome.code,
        reason=task.named_in_batch(outcome.sentence(particulars)),
        key=task.key,
        given=task.given,
    )
    with suppress(NotWritten):
        task.results.claim()
        task.results.forget()
        write_record(task.results.record, record)
    return record


def kept_record(task: FruitTask, before: FruitRecord, batch_fruits: Collection[str]) -> FruitRecord | None:
    """The record `before` of an earlier run with the present cells of fruits.csv; None if it is not valid.
    `batch_fruits`: every fruit_id of the batch.
    """
    if before.key != task.key:
        return None
    if before.outcome in RETRIED:
        return None
    if any((named_row(name, batch_fruits) is not None) != was for name, was in before.strangers.items()):
        return None
    if before.graded and before.mesh is not None and not task.results.fruit_ply.is_file():
        return None
    if before.graded and task.screen and (before.screen is None or before.screen.again):
        return None
    now = before.model_copy(update={"given": task.given})
    return write_changed(task.results.record, before, now)

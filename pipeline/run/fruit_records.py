"""Records of fruit that this run does not grade: kept from an earlier one, refused, or ended without one."""

from collections.abc import Collection, Sequence
from contextlib import suppress

from pipeline.batch.layout import Results
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import FruitRecord, read_record, write_record
from pipeline.batch.task import FruitTask
from pipeline.files.whole_file import NotWritten
from pipeline.fruit.recording_owner import named_row

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
"""Endings that may come out otherwise when tried again, or that the fruit's own files do not settle."""


def with_forced(record: FruitRecord, forced: Sequence[str], results: Results) -> FruitRecord:
    """The record of a graded fruit with these doubts for those that an earlier run forced; kept so."""
    now = tuple(forced) if record.graded else ()
    if now == record.forced:
        return record
    path = results.fruit(record.fruit_id).record
    record = read_record(path) or record
    doubts, warnings = (
        (*now, *(sentence for sentence in said if sentence not in record.forced))
        for said in (record.doubts, record.warnings)
    )
    record = record.model_copy(update={"forced": now, "doubts": doubts, "warnings": warnings})
    write_record(path, record)
    return record


def ended_record(task: FruitTask, outcome: Outcome, particulars: str) -> FruitRecord:
    """The record of a fruit whose process wrote none; where none can be written, it is told only."""
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
    """The record `before` of an earlier run with what staff wrote of the fruit brought up to date; None where
    it does not hold. `batch_fruits`: every fruit_id of the batch.
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
    record = before.model_copy(update={"given": task.given})
    if record != before:
        write_record(task.results.record, record)
    return record

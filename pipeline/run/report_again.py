"""`drupe report`: ranking and report anew from what a run kept, without computing any fruit."""

import time
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import open_batch, unlisted_fruit
from pipeline.batch.provenance import require_provenance
from pipeline.batch.records import FruitRecord, read_record, write_record
from pipeline.batch.results_lock import results_lock
from pipeline.exit_status import INTERRUPTED
from pipeline.files.plain_file import printable
from pipeline.problem import refused
from pipeline.run.batch_run import BatchRun, ReportOptions
from pipeline.run.reporting import report_of_records
from reports.entries import BatchEntry


def report_again(out: Path, batch: Path | None, *, options: ReportOptions) -> BatchEntry | None:
    """Writes ranking and report of the records in `out`, by the batch.toml of now; what the report says.

    `batch`: the batch's folder, where it is no longer where it was graded. None where fruit are still missing
    and the page says so. Raises BatchRefused where there is nothing to report, and NotWritten.
    """
    options.require_parts()
    results = Results(out)
    said = require_provenance(results)
    root = batch or Path(str(said.get("batch", "")))
    if not BatchFolder(root).settings.is_file():
        sentence = (
            f"belongs to the batch {printable(str(root))}, which does not exist; give the batch with --batch."
        )
        raise refused(results.provenance, sentence)
    opened = open_batch(root, force=True, choose=partial(_with_records, results))
    started, ended = _times(said, results)
    run = BatchRun(
        batch=opened,
        results=results,
        inputs=_hashes(said),
        force=bool(said.get("force")),
        screen=bool(said.get("screened", True)),
        options=options,
        started=started,
        since_s=time.monotonic() - (ended - started).total_seconds(),
    )
    with results_lock(out):
        run.require_ours()
        records: dict[str, FruitRecord] = {}
        for row in opened.rows:
            path = results.fruit(row.fruit_id).record
            if (record := read_record(path)) is not None:
                records[row.fruit_id] = _as_noted_now(record, row, path)
        if not records:
            raise refused(out, "contains no fruit's record; run `drupe grade` first.")
        status, entry = report_of_records(run, records)
        return None if status == INTERRUPTED else entry


def _with_records(results: Results, folder: BatchFolder, rows: tuple[FruitRow, ...]) -> tuple[FruitRow, ...]:
    """The rows, and those folders without one that `drupe watch` has graded."""
    watched = [row for row in unlisted_fruit(folder, rows) if results.fruit(row.fruit_id).record.is_file()]
    return (*rows, *watched)


def _as_noted_now(record: FruitRecord, row: FruitRow, path: Path) -> FruitRecord:
    """The record with notes and the user's own columns as fruits.csv has them now; kept so."""
    given = record.given.model_copy(update={"notes": row.notes, "columns": row.columns})
    if given == record.given:
        return record
    record = record.model_copy(update={"given": given})
    write_record(path, record)
    return record


def _times(said: Mapping[str, Any], results: Results) -> tuple[datetime, datetime]:
    try:
        started = datetime.fromisoformat(said["started_utc"])
        return started, datetime.fromisoformat(said.get("finished_utc") or said["started_utc"])
    except (KeyError, TypeError, ValueError):
        sentence = "contains no readable times; run `drupe grade` again."
        raise refused(results.provenance, sentence) from None


def _hashes(said: Mapping[str, Any]) -> dict[str, str]:
    inputs = said.get("inputs")
    return {str(k): str(v) for k, v in inputs.items()} if isinstance(inputs, dict) else {}

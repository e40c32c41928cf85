"""Folders of results as `drupe grade` leaves them, made of numbers alone."""

import csv
import sqlite3
from datetime import UTC, datetime

from pipeline.batch.fruits_table import Given
from pipeline.batch.layout import Results
from pipeline.batch.provenance import utc_text, write_provenance
from pipeline.batch.records import FruitRecord, ModulusRecord, write_record
from pipeline.run.scheduling import Finished


def graded(fruit_id, E_MPa, *, sd=0.05, doubts=(), changes=None, **given):
    """A fruit that is graded; `changes`: fields of its record."""
    record = FruitRecord(
        fruit_id=fruit_id,
        outcome="graded",
        key="k",
        given=Given(**given),
        modulus=ModulusRecord(E_MPa=E_MPa, E_sd_MPa=sd * E_MPa),
        doubts=tuple(doubts),
    )
    return record.model_copy(update=changes or {})


def written(task, E_MPa, *, changes=None, **how):
    """`graded`'s record of a task's fruit, where grading writes it."""
    changes = {"key": task.key, "given": task.given, **(changes or {})}
    record = graded(task.fruit_id, E_MPa, changes=changes, **how)
    task.results.claim()
    write_record(task.results.record, record)
    return record


def work_at_once(record):
    """Takes the place of grading's work on fruit: `record` makes each one's record at once."""

    def work(queue, _engine, ended, _waiting):
        for fruit_id, task in queue:
            done = task.result if isinstance(task, Finished) else record(fruit_id, task)
            queue.records[fruit_id] = done
            ended(done)

    return work


def results_of(out, records, *, day="2026-08-10", status=0, inputs=None, **settings):
    """Results of one batch, graded at noon of `day`."""
    results = Results(out)
    results.claim()
    for record in records:
        folder = results.fruit(record.fruit_id)
        folder.root.mkdir(parents=True, exist_ok=True)
        folder.claim()
        write_record(folder.record, record)
    outcomes = {record.fruit_id: record.outcome for record in records}
    at = datetime.fromisoformat(f"{day}T12:00:00").replace(tzinfo=UTC)
    content = {
        "batch": str(out.parent),
        "settings": {"category": "nectarine", **settings},
        "inputs": inputs or {f"fruits/{name}/grasps/a.h5": f"{day}{out}{name}" for name in outcomes},
        "started_utc": utc_text(at),
        "finished_utc": utc_text(at),
        "exit_status": status,
        "outcomes": outcomes,
    }
    write_provenance(results.provenance, content)
    return out


def rows(results, table="ranking.csv"):
    """A table's rows by fruit."""
    lines = (results / table).read_text("utf-8").splitlines()
    return {row["fruit_id"]: row for row in csv.DictReader(lines)}


def queried(store, sql):
    """Rows of a store of history."""
    with sqlite3.connect(store) as database:
        rows = database.execute(sql).fetchall()
    database.close()
    return rows

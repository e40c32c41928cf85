"""The tables of a store, each row with the SHA-256 of what it holds, so that damage is noticed and named.

`row` has a row per batch, fruit and revision (the batch's own with an empty fruit), `conversion` one per
scale, cultivar and version, `whole` the SHA-256 of all rows' hashes, by which a lost row is noticed.
"""

import hashlib
import json
import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from pipeline.history.kept_batch import Content, KeptBatch, KeptRow, batch_of_first_store
from pipeline.history.stored_batch import StoredBatch

VERSION = 2
"""SQLite's user_version of the tables below."""
_TABLES = (
    "CREATE TABLE row (batch TEXT NOT NULL, fruit TEXT NOT NULL, revision INTEGER NOT NULL, graded TEXT "
    "NOT NULL, content TEXT NOT NULL, sha256 TEXT NOT NULL, PRIMARY KEY (batch, fruit, revision))",
    "CREATE TABLE conversion (scale TEXT NOT NULL, cultivar TEXT NOT NULL, version INTEGER NOT NULL, "
    "content TEXT NOT NULL, sha256 TEXT NOT NULL, PRIMARY KEY (scale, cultivar, version))",
    "CREATE TABLE whole (sha256 TEXT NOT NULL)",
)


class Refused(ValueError):
    """Why the tables cannot be read, a sentence without its end."""


@dataclass(frozen=True, kw_only=True)
class DamagedRow:
    """A row whose SHA-256 is another; `batch` is empty where it is of no batch."""

    batch: str
    fruit_id: str
    words: str


@dataclass(kw_only=True)
class KeptRows:
    """All that a store holds: batches by their names, conversions by scale, cultivar and version."""

    batches: dict[str, KeptBatch] = field(default_factory=dict)
    conversions: dict[tuple[str, str, int], Content] = field(default_factory=dict)
    damaged: list[DamagedRow] = field(default_factory=list)

    def digest(self) -> str:
        """SHA-256 of all rows' own, in order."""
        own = [line[-1] for line in (*_lines(self), *_conversion_lines(self))]
        return _of_all(own)


def make_tables(database: sqlite3.Connection) -> None:
    """Empty ones, and their version."""
    for statement in _TABLES:
        database.execute(statement)
    database.execute("INSERT INTO whole VALUES (?)", (_of_all([]),))
    database.execute(f"PRAGMA user_version = {VERSION}")


def read_rows(database: sqlite3.Connection) -> KeptRows:
    """All rows; those that are damaged in `damaged`. Raises Refused where the database itself is, and
    sqlite3.DatabaseError.
    """
    (said,) = database.execute("PRAGMA quick_check(1)").fetchone()
    if said != "ok":
        raise Refused(f"is damaged ({said})")
    found, own = KeptRows(), list[str]()
    by_batch: dict[str, list[KeptRow]] = defaultdict(list)
    for batch, fruit, revision, graded, content, sha in database.execute(
        "SELECT batch, fruit, revision, graded, content, sha256 FROM row NOT INDEXED"
    ):
        own.append(str(sha))
        if _sha256("row", batch, fruit, revision, graded, content) != sha:
            what = f"fruit {fruit}, revision {revision}" if fruit else f"revision {revision}"
            found.damaged.append(
                DamagedRow(batch=str(batch), fruit_id=str(fruit), words=f"batch {batch}, {what}")
            )
            continue
        by_batch[batch].append(
            KeptRow(fruit_id=fruit, revision=revision, graded_utc=graded, content=json.loads(content))
        )
    for batch, rows in by_batch.items():
        if any(not row.fruit_id for row in rows):
            found.batches[batch] = KeptBatch(key=batch, rows=tuple(sorted(rows, key=_order)))
    for scale, cultivar, version, content, sha in database.execute(
        "SELECT scale, cultivar, version, content, sha256 FROM conversion NOT INDEXED"
    ):
        own.append(str(sha))
        if _sha256("conversion", scale, cultivar, version, content) != sha:
            words = f"the conversion {scale}@{version} of {cultivar} is damaged (its SHA-256 is another)"
            found.damaged.append(DamagedRow(batch="", fruit_id="", words=words))
            continue
        found.conversions[scale, cultivar, version] = json.loads(content)
    whole = [str(sha) for (sha,) in database.execute("SELECT sha256 FROM whole")]
    if not found.damaged and whole != [_of_all(own)]:
        words = "lacks rows that were written, or has others (the SHA-256 of all rows is another)"
        found.damaged.append(DamagedRow(batch="", fruit_id="", words=words))
    return found


def write_rows(database: sqlite3.Connection, rows: KeptRows) -> None:
    """Writes all rows in place of those there are."""
    for table in ("row", "conversion", "whole"):
        database.execute(f"DELETE FROM {table}")
    database.executemany("INSERT INTO row VALUES (?, ?, ?, ?, ?, ?)", _lines(rows))
    database.executemany("INSERT INTO conversion VALUES (?, ?, ?, ?, ?)", _conversion_lines(rows))
    database.execute("INSERT INTO whole VALUES (?)", (rows.digest(),))


def migrate(database: sqlite3.Connection, rows: KeptRows) -> Iterator[StoredBatch]:
    """Batches of a store of the first version, in the order in which they were graded; its conversions go to
    `rows`, and its tables give way to those of now. Raises Refused where a row cannot be read.
    """
    try:
        kept = [json.loads(content) for (content,) in database.execute("SELECT content FROM batch")]
        found = [batch_of_first_store(content) for content in kept]
        for scale, cultivar, version, content in database.execute("SELECT * FROM conversion"):
            rows.conversions[scale, cultivar, version] = json.loads(content)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise Refused(f"is damaged: it holds a row that cannot be read ({error})") from None
    database.execute("DROP TABLE batch")
    database.execute("DROP TABLE conversion")
    make_tables(database)
    yield from sorted(found, key=lambda one: one.graded_utc)


def _lines(rows: KeptRows) -> list[tuple[Any, ...]]:
    """Of the table `row`."""
    return [
        _with_hash("row", key, row.fruit_id, row.revision, row.graded_utc, _json(row.content))
        for key, kept in sorted(rows.batches.items())
        for row in sorted(kept.rows, key=_order)
    ]


def _conversion_lines(rows: KeptRows) -> list[tuple[Any, ...]]:
    return [
        _with_hash("conversion", *key, _json(content)) for key, content in sorted(rows.conversions.items())
    ]


def _order(row: KeptRow) -> tuple[int, str]:
    return row.revision, row.fruit_id


def _with_hash(table: str, *values: object) -> tuple[Any, ...]:
    return (*values, _sha256(table, *values))


def _json(content: Content | None) -> str:
    return json.dumps(content, sort_keys=True)


def _sha256(*values: object) -> str:
    return hashlib.sha256(json.dumps([str(value) for value in values]).encode()).hexdigest()


def _of_all(own: list[str]) -> str:
    return _sha256("whole", *sorted(own))

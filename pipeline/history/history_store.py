"""The file in which `drupe history --store` keeps batches and conversions: an SQLite database.

It is the user's to name and drupe's alone to write: another file, or another program's database, is refused.
A batch is kept as JSON beside the columns that it is found by, so that a later version can read it.
"""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from datetime import date
from pathlib import Path
from typing import Any

from pipeline.history.scale_conversion import ScaleConversion
from pipeline.history.stored_batch import StoredBatch, StoredFruit
from pipeline.problem import BatchRefused, Problem
from recon.plain_file import not_plain

APPLICATION = 0x44525550
"""SQLite's application_id of a store: "DRUP" in ASCII."""
VERSION = 1
"""SQLite's user_version of the tables below."""
WAIT_S = 20.0
"""Seconds that another run of drupe is waited for."""
_TABLES = """
CREATE TABLE batch (key TEXT PRIMARY KEY, measured TEXT NOT NULL, category TEXT NOT NULL,
                    cultivar TEXT NOT NULL, lot TEXT NOT NULL, content TEXT NOT NULL);
CREATE TABLE conversion (scale TEXT NOT NULL, cultivar TEXT NOT NULL, version INTEGER NOT NULL,
                         content TEXT NOT NULL, PRIMARY KEY (scale, cultivar, version));
"""


class HistoryStore:
    """Batches by day and conversions by version; changes are kept when the block of `history_store` ends."""

    def __init__(self, database: sqlite3.Connection, path: Path | None) -> None:
        self._database, self.path = database, path

    def add(self, batch: StoredBatch) -> bool:
        """Adds a batch; the same one graded again takes its former place and keeps its day. Whether it is
        new.
        """
        known = self._rows("SELECT content FROM batch WHERE key = ?", batch.key)
        if known:
            batch = replace(batch, measured=_batch(known[0][0]).measured)
        row = (batch.key, batch.measured.isoformat(), batch.category, batch.cultivar, batch.lot)
        self._database.execute(
            "INSERT OR REPLACE INTO batch VALUES (?, ?, ?, ?, ?, ?)",
            (*row, json.dumps(asdict(batch), default=str)),
        )
        return not known

    def batches(self) -> tuple[StoredBatch, ...]:
        """All, oldest first. Raises BatchRefused where one cannot be read."""
        rows = self._rows("SELECT content FROM batch ORDER BY measured, key")
        try:
            return tuple(_batch(content) for (content,) in rows)
        except (ValueError, TypeError, KeyError) as error:
            raise self._refused(f"holds a batch that cannot be read ({error})") from None

    def add_conversion(self, one: ScaleConversion) -> None:
        """Keeps a conversion; versions are never replaced."""
        self._database.execute(
            "INSERT INTO conversion VALUES (?, ?, ?, ?)",
            (one.scale, one.group, one.version, json.dumps(asdict(one))),
        )

    def conversions(self) -> tuple[ScaleConversion, ...]:
        """All, by scale, cultivar and version."""
        rows = self._rows("SELECT content FROM conversion ORDER BY scale, cultivar, version")
        return tuple(ScaleConversion(**json.loads(content)) for (content,) in rows)

    def _rows(self, query: str, *values: str) -> list[tuple[Any, ...]]:
        try:
            return self._database.execute(query, values).fetchall()
        except sqlite3.DatabaseError as error:
            raise self._refused(f"is damaged ({error})") from None

    def _refused(self, sentence: str) -> BatchRefused:
        return BatchRefused(
            [Problem(str(self.path or "store"), f"{sentence}; name another file with --store.")]
        )


@contextmanager
def history_store(path: Path | None) -> Iterator[HistoryStore]:
    """The store at `path`, made where there is none; one in memory where `path` is None.

    What is added in the block is kept when it ends, and nothing of it where it raises. Raises BatchRefused
    where a file stands there that is no store of drupe's.
    """

    def refused(sentence: str) -> BatchRefused:
        return BatchRefused([Problem(str(path), f"{sentence}; name another file with --store.")])

    if path is not None:
        if not path.parent.is_dir():
            raise refused(f"cannot be written: there is no folder {path.parent}")
        if path.is_symlink():
            raise refused("is a link, and is not written through; name the file that it leads to")
        if path.exists() and (why := not_plain(path)):
            raise refused(f"{why}, expected a file that drupe history made")
    new = path is None or not path.exists() or path.stat().st_size == 0
    if path is not None and not new and path.read_bytes()[:16] != b"SQLite format 3\x00":
        raise refused("is no store of drupe history, and is not overwritten")
    try:
        database = sqlite3.connect(":memory:" if path is None else path, timeout=WAIT_S, isolation_level=None)
    except sqlite3.Error as error:
        raise refused(f"cannot be opened ({error})") from None
    try:
        database.execute("BEGIN IMMEDIATE" if path else "BEGIN")
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        if new and application == 0:
            for statement in _TABLES.split(";")[:-1]:
                database.execute(statement)
            database.execute(f"PRAGMA application_id = {APPLICATION}")
            database.execute(f"PRAGMA user_version = {VERSION}")
        elif application != APPLICATION:
            raise refused("is another program's database, and is not written to")
        elif version > VERSION:
            raise refused(f"is of a later version of drupe ({version}, this one writes {VERSION})")
        yield HistoryStore(database, path)
        database.execute("COMMIT")
    except sqlite3.OperationalError as error:
        raise refused(f"cannot be written ({error})") from None
    except sqlite3.DatabaseError as error:
        raise refused(f"is damaged ({error})") from None
    finally:
        database.close()


def _batch(content: str) -> StoredBatch:
    """A batch from its JSON; fields that this version does not know are left out."""
    said = json.loads(content)
    known = {one.name for one in fields(StoredBatch)}
    fruit_fields = {one.name for one in fields(StoredFruit)}
    own = {name: value for name, value in said.items() if name in known}
    own |= {
        "measured": date.fromisoformat(said["measured"]),
        "harvest": date.fromisoformat(said["harvest"]) if said["harvest"] else None,
        "limits": tuple((str(name), limit) for name, limit in said["limits"]),
        "fruit": tuple(
            StoredFruit(**{name: value for name, value in one.items() if name in fruit_fields})
            for one in said["fruit"]
        ),
    }
    return StoredBatch(**own)

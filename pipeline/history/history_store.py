"""The file in which `drupe history --store` keeps batches and conversions: an SQLite database.

It is the user's to name and drupe's alone to write: another file, or another program's database, is refused.
Table `row` has a row per batch, fruit and revision (the batch's own with an empty fruit), `conversion` one
per scale, cultivar and version, each with the SHA-256 of what it holds, so that damage is noticed and named;
`whole` has the SHA-256 of all rows' hashes, by which a lost row is noticed.
"""

import hashlib
import json
import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

from pipeline.files.plain_file import not_plain
from pipeline.history.revisions import KeptBatch, KeptRow, is_same_batch, rows_of
from pipeline.history.scale_conversion import ScaleConversion
from pipeline.history.stored_batch import StoredBatch
from pipeline.problem import BatchRefused, Problem, refused

APPLICATION = 0x44525550
"""SQLite's application_id of a store: "DRUP" in ASCII."""
VERSION = 2
"""SQLite's user_version of the tables."""
WAIT_S = 20.0
"""Seconds that another run of drupe is waited for."""
NAME_LENGTH = 12
"""Hexadecimal digits of a batch's name: two of ten thousand batches are alike with a probability of 2e-7."""
SHOWN = 20
"""Batches that a sentence names, with their lots."""
_TABLES = {
    "row": "batch TEXT, fruit TEXT, revision INTEGER, graded TEXT, content TEXT, sha256 TEXT, "
    "PRIMARY KEY (batch, fruit, revision)",
    "conversion": "scale TEXT, cultivar TEXT, version INTEGER, content TEXT, sha256 TEXT, "
    "PRIMARY KEY (scale, cultivar, version)",
    "whole": "sha256 TEXT",
}
"""Tables and their columns."""
Line = tuple[str | int, ...]
"""A row of a table, its SHA-256 last."""


class DamagedRow(NamedTuple):
    """A row whose SHA-256 differs; `batch` is empty where it belongs to no batch."""

    batch: str
    fruit_id: str
    words: str


@dataclass(kw_only=True)
class HistoryStore:
    """Batches by name and conversions by scale, cultivar and version; changes are kept when the block of
    `history_store` ends.
    """

    path: Path | None
    kept: dict[str, KeptBatch] = field(default_factory=dict)
    fitted: dict[tuple[str, str, int], ScaleConversion] = field(default_factory=dict)
    damaged: list[DamagedRow] = field(default_factory=list)

    def add(self, batch: StoredBatch) -> bool:
        """Adds a batch. Results of a batch that the store has become its next revision, where they differ
        from what is known. Whether the batch is new.
        """
        key = batch.key[:NAME_LENGTH]
        for name, kept in self.kept.items():
            if name == key or any(is_same_batch(batch, earlier) for earlier in kept.each()):
                self.kept[name] = KeptBatch(key=name, rows=(*kept.rows, *kept.new_rows(batch)))
                return False
        self.kept[key] = KeptBatch(key=key, rows=tuple(rows_of(batch)))
        return True

    def batches(self) -> tuple[StoredBatch, ...]:
        """The latest results of all, oldest day first."""
        latest = [kept.latest() for kept in self.kept.values()]
        return tuple(sorted(latest, key=lambda batch: (batch.measured, batch.key)))

    def add_conversion(self, conversion: ScaleConversion) -> None:
        """Keeps a conversion; versions are never replaced."""
        self.fitted[conversion.scale, conversion.group, conversion.version] = conversion

    def conversions(self) -> tuple[ScaleConversion, ...]:
        """All, by scale, cultivar and version."""
        return tuple(conversion for _, conversion in sorted(self.fitted.items()))

    def forget(self, named: str) -> list[str]:
        """Removes all revisions of batches, or of one fruit of them, from the store alone. `named`: a batch's
        name in the store, its folder (or the last part of it) or its lot; with "/" and a fruit's id after it,
        that fruit alone. A line for each batch. Raises BatchRefused where nothing is named so.
        """
        keys, fruit_id = self._keys(named), ""
        if not keys and "/" in named:
            batch, _, fruit_id = named.rpartition("/")
            keys = [key for key in self._keys(batch) if fruit_id in self._fruit(key)]
        if not keys:
            known = "; ".join(self.words(key) for key in self._names()[:SHOWN]) or "it is empty"
            sentence = f'contains no batch, lot or fruit "{named}" (from --forget); it contains: {known}.'
            raise refused(str(self.path or "store"), sentence)
        return [self._forget(key, fruit_id) for key in keys]

    def words(self, key: str) -> str:
        """A batch's name in the store with what people know it by."""
        if (kept := self.kept.get(key)) is None:
            return f"batch {key}, which is damaged"
        batch = kept.latest()
        lot = f", lot {batch.lot}" if batch.lot else ""
        return f"batch {key}{lot}, measured {batch.measured}, {batch.folder}"

    def _forget(self, key: str, fruit_id: str) -> str:
        words, known = self.words(key), sorted(self._fruit(key))
        kept = self.kept.pop(key, None)
        former = {} if kept is None else kept.renamed()
        gone = [name for name in known if fruit_id in ("", name, former.get(name))]
        whole = gone == known
        if kept is not None and not whole:
            rows = tuple(row for row in kept.rows if row.fruit_id not in gone)
            self.kept[key] = KeptBatch(key=key, rows=rows)
        self.damaged = [
            row for row in self.damaged if row.batch != key or not (whole or row.fruit_id in gone)
        ]
        return f"{words}: {'the batch with fruit' if whole else 'fruit'} {', '.join(gone) or 'none'}"

    def _names(self) -> list[str]:
        return list(dict.fromkeys([*self.kept, *(row.batch for row in self.damaged if row.batch)]))

    def _keys(self, named: str) -> list[str]:
        latest = {key: kept.latest() for key, kept in self.kept.items()}
        known = {
            key: (key, batch.lot, batch.folder, Path(batch.folder).name) for key, batch in latest.items()
        }
        place = named.rstrip("/")
        return [key for key in self._names() if named and (key == named or place in known.get(key, ()))]

    def _fruit(self, key: str) -> set[str]:
        rows = self.kept[key].rows if key in self.kept else ()
        damaged = {row.fruit_id for row in self.damaged if row.batch == key}
        return ({row.fruit_id for row in rows} | damaged) - {""}

    def lines(self) -> dict[str, list[Line]]:
        """All rows of every table as they are written."""
        rows = [
            _hashed("row", key, row.fruit_id, row.revision, row.graded_utc, row.content)
            for key, kept in sorted(self.kept.items())
            for row in sorted(kept.rows, key=lambda row: (row.revision, row.fruit_id))
        ]
        conversions = [
            _hashed("conversion", *key, json.dumps(asdict(conversion), sort_keys=True))
            for key, conversion in sorted(self.fitted.items())
        ]
        return {"row": rows, "conversion": conversions, "whole": [_of_all([*rows, *conversions])]}


@contextmanager
def history_store(
    path: Path | None, *, damaged_too: bool = False, read_only: bool = False
) -> Iterator[HistoryStore]:
    """The store at `path`, made where there is none; one in memory where `path` is None.

    What is added in the block is kept when it ends, and nothing of it where it raises. Raises BatchRefused
    where a file stands there that is no store of drupe's, and with every row that is damaged, unless
    `damaged_too`: then sound rows are there, and damaged ones can be forgotten. `read_only`: nothing is kept.
    """

    def unfit(sentence: str) -> BatchRefused:
        return refused(str(path), f"{sentence}; name another file with --store.")

    new = path is None or not path.exists() or path.stat().st_size == 0
    if path is not None and (why := _no_place(path)):
        raise unfit(why)
    try:
        database = sqlite3.connect(":memory:" if path is None else path, timeout=WAIT_S, isolation_level=None)
    except sqlite3.Error as error:
        raise unfit(f"does not open ({error})") from None
    try:
        database.execute("BEGIN IMMEDIATE" if path else "BEGIN")
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        if new and application == 0:
            database.execute(f"PRAGMA application_id = {APPLICATION}")
            database.execute(f"PRAGMA user_version = {VERSION}")
            for table, columns in _TABLES.items():
                database.execute(f"CREATE TABLE {table} ({columns})")
            database.execute("INSERT INTO whole VALUES (?)", _of_all([]))
        elif application != APPLICATION:
            raise unfit("belongs to another program; drupe does not write to it")
        elif version != VERSION:
            raise unfit(f"comes from another version of drupe ({version}; this drupe writes {VERSION})")
        (said,) = database.execute("PRAGMA quick_check(1)").fetchone()
        if said != "ok":
            raise unfit(f"is damaged ({said})")
        store = _read(database, path)
        _require_sound(store, damaged_too=damaged_too)
        before = [] if store.damaged else store.lines()["whole"]
        yield store
        if read_only:
            return
        _require_sound(store, damaged_too=False)
        lines = store.lines()
        if lines["whole"] != before:
            for table, rows in lines.items():
                database.execute(f"DELETE FROM {table}")
                for line in rows:
                    database.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(line))})", line)
        database.execute("COMMIT")
    except sqlite3.OperationalError as error:
        raise unfit(f"is not writable ({error})") from None
    except sqlite3.DatabaseError as error:
        raise unfit(f"is damaged ({error})") from None
    finally:
        database.close()


def _no_place(path: Path) -> str:
    """Why no store can be at `path`; empty where it can."""
    if not path.parent.is_dir():
        return f"cannot be written: there is no folder {path.parent}"
    if path.is_symlink():
        return "is a link, and drupe does not write through links; name the target file"
    if not path.exists():
        return ""
    if why := not_plain(path):
        return f"{why}, expected a file that drupe history made"
    if path.stat().st_size and path.read_bytes()[:16] != b"SQLite format 3\x00":
        return "is not a store of drupe history; drupe does not overwrite it"
    return ""


def _read(database: sqlite3.Connection, path: Path | None) -> HistoryStore:
    """All sound rows, the others in `damaged`. Raises sqlite3.DatabaseError."""
    lines = {table: database.execute(f"SELECT * FROM {table} NOT INDEXED").fetchall() for table in _TABLES}
    store, by_batch = HistoryStore(path=path), defaultdict[str, list[KeptRow]](list)
    for line in lines["row"]:
        batch, fruit, revision, graded, content, _ = line
        if line == _hashed("row", *line[:-1]):
            row = KeptRow(fruit_id=fruit, revision=revision, graded_utc=graded, content=content)
            by_batch[batch].append(row)
        else:
            what = f"fruit {fruit}, revision {revision}" if fruit else f"revision {revision}"
            store.damaged.append(DamagedRow(str(batch), str(fruit), f"batch {batch}, {what}"))
    for batch, rows in by_batch.items():
        if any(not row.fruit_id for row in rows):
            store.kept[batch] = KeptBatch(key=batch, rows=tuple(rows))
    for line in lines["conversion"]:
        scale, cultivar, version, content, _ = line
        if line == _hashed("conversion", *line[:-1]):
            store.add_conversion(ScaleConversion(**json.loads(content)))
        else:
            words = f"the conversion {scale}@{version} of {cultivar} is damaged (its SHA-256 is another)"
            store.damaged.append(DamagedRow("", "", words))
    if not store.damaged and lines["whole"] != [_of_all([*lines["row"], *lines["conversion"]])]:
        words = "lacks rows that were written, or has others (the SHA-256 of all rows is another)"
        store.damaged.append(DamagedRow("", "", words))
    return store


def _hashed(table: str, *cells: str | int) -> Line:
    return (*cells, _sha256(table, *cells))


def _of_all(lines: list[Line]) -> Line:
    return (_sha256("whole", *sorted(str(line[-1]) for line in lines)),)


def _sha256(*cells: str | int) -> str:
    return hashlib.sha256(json.dumps([str(cell) for cell in cells]).encode()).hexdigest()


def _require_sound(store: HistoryStore, *, damaged_too: bool) -> None:
    """Raises BatchRefused with a problem for each damaged row, and what removes it."""
    if store.damaged and not damaged_too:
        raise BatchRefused(Problem(str(store.path), _how_to_mend(row)) for row in store.damaged)


def _how_to_mend(row: DamagedRow) -> str:
    if not row.batch:
        return f"{row.words}; create a new store from the results folders, or use a backup of this one."
    named = f"{row.batch}/{row.fruit_id}" if row.fruit_id else row.batch
    return (
        f"{row.words} is damaged (its SHA-256 differs); remove it with --forget {named}, then add its "
        "results folder again."
    )

"""The file in which `drupe history --store` keeps batches and conversions: an SQLite database.

It is the user's to name and drupe's alone to write: another file, or another program's database, is refused.
Results are kept by batch, fruit and revision, as JSON with a SHA-256 of each row.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.files.plain_file import not_plain
from pipeline.history.kept_batch import KeptBatch, rows_of
from pipeline.history.kept_rows import (
    VERSION,
    KeptRows,
    Refused,
    make_tables,
    migrate,
    read_rows,
    write_rows,
)
from pipeline.history.same_batch import is_same_batch
from pipeline.history.scale_conversion import ScaleConversion
from pipeline.history.stored_batch import StoredBatch
from pipeline.problem import BatchRefused, Problem

APPLICATION = 0x44525550
"""SQLite's application_id of a store: "DRUP" in ASCII."""
WAIT_S = 20.0
"""Seconds that another run of drupe is waited for."""
NAME_LENGTH = 12
"""Hexadecimal digits of a batch's name: two of ten thousand batches are alike with a probability of 2e-7."""
SHOWN = 20
"""Batches that a sentence names, with their lots."""


@dataclass(frozen=True, kw_only=True)
class Forgotten:
    """What was forgotten of one batch: its name in words, the fruit, and whether it was all of the batch."""

    batch: str
    fruit: tuple[str, ...]
    whole: bool

    @property
    def words(self) -> str:
        """In a line."""
        names = ", ".join(self.fruit)
        return f"{self.batch}: {'the batch with fruit' if self.whole else 'fruit'} {names or 'none'}"


class HistoryStore:
    """Batches by day and conversions by version; changes are kept when the block of `history_store` ends."""

    def __init__(self, rows: KeptRows, path: Path | None) -> None:
        self.rows, self.path = rows, path

    def add(self, batch: StoredBatch) -> bool:
        """Adds a batch. Results of a batch that the store has become its next revision, where they differ
        from what is known. Whether the batch is new.
        """
        key = batch.key[:NAME_LENGTH]
        for name, kept in self.rows.batches.items():
            if name == key or any(is_same_batch(batch, one) for one in kept.each()):
                fresh = kept.new_rows(batch)
                self.rows.batches[name] = KeptBatch(key=name, rows=(*kept.rows, *fresh))
                return False
        self.rows.batches[key] = KeptBatch(key=key, rows=tuple(rows_of(batch)))
        return True

    def batches(self) -> tuple[StoredBatch, ...]:
        """The latest results of all, oldest day first."""
        found = [kept.latest() for kept in self.rows.batches.values()]
        return tuple(sorted(found, key=lambda one: (one.measured, one.key)))

    def add_conversion(self, one: ScaleConversion) -> None:
        """Keeps a conversion; versions are never replaced."""
        self.rows.conversions[one.scale, one.group, one.version] = asdict(one)

    def conversions(self) -> tuple[ScaleConversion, ...]:
        """All, by scale, cultivar and version."""
        return tuple(ScaleConversion(**content) for _, content in sorted(self.rows.conversions.items()))

    def forget(self, named: str) -> list[Forgotten]:
        """Removes all revisions of batches, or of one fruit of them, from the store alone. `named`: a batch's
        name in the store, its folder (or the last part of it) or its lot; with "/" and a fruit's id after it,
        that fruit alone. What was forgotten. Raises BatchRefused where nothing is named so.
        """
        keys, fruit_id = self._keys(named), ""
        if not keys and "/" in named:
            batch, _, fruit_id = named.rpartition("/")
            keys = [key for key in self._keys(batch) if fruit_id in self._fruit(key)]
        if not keys:
            known = "; ".join(self.words(key) for key in [*self._all()][:SHOWN]) or "it is empty"
            sentence = f'contains no batch, lot or fruit "{named}" (from --forget); it contains: {known}.'
            raise BatchRefused([Problem(str(self.path or "store"), sentence)])
        return [self._forget(key, fruit_id) for key in keys]

    def words(self, key: str) -> str:
        """A batch's name in the store with what people know it by."""
        if (kept := self.rows.batches.get(key)) is None:
            return f"batch {key}, which is damaged"
        batch = kept.latest()
        lot = f", lot {batch.lot}" if batch.lot else ""
        return f"batch {key}{lot}, measured {batch.measured}, {batch.folder}"

    def _forget(self, key: str, fruit_id: str) -> Forgotten:
        words, known = self.words(key), sorted(self._fruit(key))
        kept = self.rows.batches.get(key)
        former = {} if kept is None else kept.renamed()
        gone = [name for name in known if fruit_id in ("", name, former.get(name))]
        whole = gone == known
        self.rows.batches.pop(key, None)
        if kept is not None and not whole:
            left = tuple(row for row in kept.rows if row.fruit_id not in gone)
            self.rows.batches[key] = KeptBatch(key=key, rows=left)
        self.rows.damaged = [
            one for one in self.rows.damaged if one.batch != key or not (whole or one.fruit_id in gone)
        ]
        return Forgotten(batch=words, fruit=tuple(gone), whole=whole)

    def _all(self) -> list[str]:
        return list(
            dict.fromkeys([*self.rows.batches, *(one.batch for one in self.rows.damaged if one.batch)])
        )

    def _keys(self, named: str) -> list[str]:
        """The batches of that name, folder or lot."""
        found = [key for key in self._all() if key == named]
        for key, kept in self.rows.batches.items():
            batch = kept.latest()
            folder = Path(batch.folder)
            if named and named.rstrip("/") in (batch.lot, batch.folder, folder.name):
                found.append(key)
        return list(dict.fromkeys(found))

    def _fruit(self, key: str) -> set[str]:
        rows = () if (kept := self.rows.batches.get(key)) is None else kept.rows
        damaged = {one.fruit_id for one in self.rows.damaged if one.batch == key}
        return ({row.fruit_id for row in rows} | damaged) - {""}


@contextmanager
def history_store(
    path: Path | None, *, damaged_too: bool = False, read_only: bool = False
) -> Iterator[HistoryStore]:
    """The store at `path`, made where there is none; one in memory where `path` is None.

    What is added in the block is kept when it ends, and nothing of it where it raises. Raises BatchRefused
    where a file stands there that is no store of drupe's, and with every row that is damaged, unless
    `damaged_too`: then sound rows are there, and damaged ones can be forgotten. `read_only`: nothing is kept.
    """

    def refused(sentence: str) -> BatchRefused:
        return BatchRefused([Problem(str(path), f"{sentence}; name another file with --store.")])

    if path is not None:
        if not path.parent.is_dir():
            raise refused(f"cannot be written: there is no folder {path.parent}")
        if path.is_symlink():
            raise refused("is a link, and drupe does not write through links; name the target file")
        if path.exists() and (why := not_plain(path)):
            raise refused(f"{why}, expected a file that drupe history made")
    new = path is None or not path.exists() or path.stat().st_size == 0
    if path is not None and not new and path.read_bytes()[:16] != b"SQLite format 3\x00":
        raise refused("is not a store of drupe history; drupe does not overwrite it")
    try:
        database = sqlite3.connect(":memory:" if path is None else path, timeout=WAIT_S, isolation_level=None)
    except sqlite3.Error as error:
        raise refused(f"does not open ({error})") from None
    try:
        database.execute("BEGIN IMMEDIATE" if path else "BEGIN")
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        if new and application == 0:
            database.execute(f"PRAGMA application_id = {APPLICATION}")
            make_tables(database)
            version = VERSION
        elif application != APPLICATION:
            raise refused("belongs to another program; drupe does not write to it")
        elif version > VERSION:
            raise refused(f"comes from a later version of drupe ({version}; this drupe writes {VERSION})")
        store = HistoryStore(KeptRows(), path)
        if version < VERSION:
            for batch in migrate(database, store.rows):
                store.add(batch)
        else:
            store.rows = read_rows(database)
            if store.rows.damaged and not damaged_too:
                raise BatchRefused(_damaged(store, path))
        before = store.rows.digest() if version == VERSION and not store.rows.damaged else ""
        yield store
        if read_only:
            return
        if store.rows.damaged:
            raise BatchRefused(_damaged(store, path))
        if store.rows.digest() != before:
            write_rows(database, store.rows)
        database.execute("COMMIT")
    except Refused as error:
        raise refused(str(error)) from None
    except sqlite3.OperationalError as error:
        raise refused(f"is not writable ({error})") from None
    except sqlite3.DatabaseError as error:
        raise refused(f"is damaged ({error})") from None
    finally:
        database.close()


def _damaged(store: HistoryStore, path: Path | None) -> Sequence[Problem]:
    """A problem for each damaged row, with what removes it."""
    return [
        Problem(
            str(path),
            (
                f"{one.words} is damaged (its SHA-256 differs); remove it with --forget "
                f"{one.batch}{'/' if one.fruit_id else ''}{one.fruit_id}, then add its results folder "
                "again."
            )
            if one.batch
            else (f"{one.words}; create a new store from the results folders, or use a backup of this one."),
        )
        for one in store.rows.damaged
    ]

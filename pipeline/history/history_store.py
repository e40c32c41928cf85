"""A store of `drupe history`: all results of every batch. The newest results of each fruit count."""

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from sqlalchemy import Connection, MetaData, Table, delete, insert, select

from pipeline.files.plain_file import composed
from pipeline.history.stored_batch import StoredBatch, StoredFruit, StoredGrasp, composed_batch
from pipeline.problem import refused

NAME_LENGTH = 12
"""Hexadecimal digits of a batch's name: two of ten thousand batches share one with a probability of 2e-7."""
SHOWN = 20
"""Most batches that a message names, with their lots."""
_BATCH = TypeAdapter(StoredBatch)


@dataclass(kw_only=True)
class HistoryStore:
    """`results`: by the batch's name, in the order of grading. `damaged`: batches with results whose SHA-256
    differs. The steps in `migrations/versions` define the tables; a column holds the field of its name.
    """

    path: Path | None
    connection: Connection
    tables: Mapping[str, Table]
    results: dict[str, list[StoredBatch]] = field(default_factory=dict)
    damaged: set[str] = field(default_factory=set)

    def add(self, batch: StoredBatch) -> bool:
        """Adds a batch; returns whether it is new. New results of a known batch become its next revision.

        drupe does not add known results again. A batch keeps its day unless its settings state another.
        """
        name = next((name for name, kept in self.results.items() if _is_of(batch, name, kept)), "")
        if not name:
            name = batch.key[:NAME_LENGTH]
            self._insert(name, batch)
            return True
        again = batch = replace(batch, key=name)
        for earlier in self.results[name]:
            if not batch.dated:
                again = replace(batch, measured=earlier.measured, dated=earlier.dated)
            if again == earlier:
                return False
        if replace(again, graded_utc=earlier.graded_utc) != earlier:
            self._insert(name, again)
        return False

    def batches(self) -> tuple[StoredBatch, ...]:
        """The latest results of all batches, oldest day first."""
        return tuple(
            sorted(map(latest, self.results.values()), key=lambda batch: (batch.measured, batch.key))
        )

    def forget(self, named: str) -> list[str]:
        """Removes all revisions of batches, or of one fruit in them, and returns a line per batch.

        `named`: a batch's name in the store, its folder (or the last part of it) or its lot. With "/" and a
        fruit's id at the end: that fruit alone. Raises BatchRefused if nothing has this name.
        """
        keys, fruit_id = self._keys(named), ""
        if not keys and "/" in named:
            batch, _, fruit_id = named.rpartition("/")
            keys = [key for key in self._keys(batch) if fruit_id in self._fruit(key)]
        if not keys:
            known = "; ".join(map(self._words, [*self.results][:SHOWN])) or "it is empty"
            sentence = f'contains no batch, lot or fruit "{named}" (from --forget); it contains: {known}.'
            raise refused(str(self.path or "store"), sentence)
        return [self._forget(key, fruit_id) for key in keys]

    def _words(self, key: str) -> str:
        """A batch's name in the store, with its lot, day and folder."""
        batch = latest(self.results[key])
        lot = f", lot {batch.lot}" if batch.lot else ""
        return f"batch {key}{lot}, measured {batch.measured}, {batch.folder}"

    def _forget(self, key: str, fruit_id: str) -> str:
        """Removes the fruit with this id (empty: all), also under former ids that the latest results lack."""
        words, kept, known = self._words(key), self.results[key], self._fruit(key)
        last = latest(kept)
        recordings = {name for fruit in last.fruit if fruit.fruit_id == fruit_id for name in fruit.recordings}
        former = {
            fruit.fruit_id for batch in kept for fruit in batch.fruit if recordings >= {*fruit.recordings}
        }
        gone = {fruit_id, *(former - _ids(last))} & known if fruit_id else known
        self._remove(key)
        for batch in kept if gone < known else ():
            fruit = tuple(specimen for specimen in batch.fruit if specimen.fruit_id not in gone)
            lost = tuple(name for name in batch.lost if name not in gone)
            self._insert(key, replace(batch, fruit=fruit, lost=lost))
        what = "fruit" if gone < known else "the batch with fruit"
        return f"{words}: {what} {', '.join(sorted(gone)) or 'none'}"

    def _keys(self, named: str) -> list[str]:
        place = named.rstrip("/")
        known = {key: latest(kept) for key, kept in self.results.items()}
        return [
            key
            for key, batch in known.items()
            if place and place in map(composed, (key, batch.lot, batch.folder, Path(batch.folder).name))
        ]

    def _fruit(self, key: str) -> set[str]:
        return set().union(*map(_ids, self.results[key]))

    def _insert(self, name: str, batch: StoredBatch) -> None:
        batch = replace(batch, key=name)
        kept = self.results.setdefault(name, [])
        cells = {"batch": name, "revision": len(kept), "sha256": _sha256(batch)}
        row = self.connection.execute(
            insert(self.tables["result"]).values(_cells(batch, self.tables["result"]) | cells)
        )
        for fruit in batch.fruit:
            key = {"result": row.lastrowid, "fruit_id": fruit.fruit_id}
            self.connection.execute(
                insert(self.tables["fruit"]).values(_cells(fruit, self.tables["fruit"]) | key)
            )
            for grasp in fruit.grasps:
                self.connection.execute(
                    insert(self.tables["grasp"]).values(_cells(grasp, self.tables["grasp"]) | key)
                )
        kept.append(batch)
        kept.sort(key=lambda result: result.graded_utc)

    def _remove(self, name: str) -> None:
        result = self.tables["result"]
        rows = select(result.c.id).where(result.c.batch == name)
        for table in (self.tables["grasp"], self.tables["fruit"]):
            self.connection.execute(delete(table).where(table.c.result.in_(rows)))
        self.connection.execute(delete(result).where(result.c.batch == name))
        del self.results[name]
        self.damaged.discard(name)


def read_store(connection: Connection, path: Path | None) -> HistoryStore:
    """The store in the tables. Raises SQLAlchemy's DatabaseError, and ValueError for damaged cells."""
    metadata = MetaData()
    metadata.reflect(connection)
    store = HistoryStore(path=path, connection=connection, tables=metadata.tables)
    result, fruit_table, grasp_table = (metadata.tables[name] for name in ("result", "fruit", "grasp"))
    grasps = defaultdict[tuple[int, str], list[StoredGrasp]](list)
    for row in connection.execute(select(grasp_table).order_by(grasp_table.c.id)).mappings():
        grasps[row["result"], row["fruit_id"]].append(StoredGrasp(**_fields(StoredGrasp, row)))
    fruit = defaultdict[int, list[StoredFruit]](list)
    for row in connection.execute(select(fruit_table).order_by(fruit_table.c.id)).mappings():
        of_fruit = tuple(grasps[row["result"], row["fruit_id"]])
        fruit[row["result"]].append(StoredFruit(**_fields(StoredFruit, row), grasps=of_fruit))
    for row in connection.execute(select(result).order_by(result.c.graded_utc, result.c.id)).mappings():
        name = str(row["batch"])
        batch = StoredBatch(**_fields(StoredBatch, row), key=name, fruit=tuple(fruit[row["id"]]))
        store.results.setdefault(name, []).append(composed_batch(batch))
        if row["sha256"] != _sha256(batch):
            store.damaged.add(name)
    return store


def latest(results: Sequence[StoredBatch]) -> StoredBatch:
    """One batch from its revisions, in the order of grading: the last results of each fruit.

    A fruit takes a later id if all its recordings reappear under that id in later results without its own id.
    """
    counted: dict[str, StoredFruit | None] = {}
    for batch in results:
        renamed = [
            name
            for name, former in counted.items()
            if former is not None and name not in batch.listed and _reappears(former, batch)
        ]
        again = {fruit.fruit_id: fruit for fruit in batch.fruit}
        counted = {name: fruit for name, fruit in counted.items() if name not in renamed}
        counted |= again | dict.fromkeys(batch.lost)
    return replace(
        results[-1],
        fruit=tuple(fruit for fruit in counted.values() if fruit is not None),
        lost=tuple(name for name, fruit in counted.items() if fruit is None),
        revisions=len(results) - 1,
    )


def _reappears(former: StoredFruit, batch: StoredBatch) -> bool:
    recordings = {*former.recordings}
    return bool(recordings) and any(recordings <= {*fruit.recordings} for fruit in batch.fruit)


def _is_of(batch: StoredBatch, name: str, kept: Sequence[StoredBatch]) -> bool:
    return batch.key[:NAME_LENGTH] == name or any(is_same_batch(batch, earlier) for earlier in kept)


def is_same_batch(first: StoredBatch, second: StoredBatch) -> bool:
    """Whether both are results of one batch. One of these holds:

    - A fruit of the same id has a recording in both (added fruit, another lot name or results folder).
    - All recordings of a fruit belong to a fruit with another id in the other batch (renamed fruit).
    - Folder, day, category, cultivar, lot, harvest and a fruit id are the same (recordings with a new
      calibration).

    Recordings of reference bodies do not count, because many batches contain them.
    """
    for fruit, other in product(_no_bodies(first), _no_bodies(second)):
        shared = {*fruit.recordings} & {*other.recordings}
        if shared and (
            fruit.fruit_id == other.fruit_id or shared in ({*fruit.recordings}, {*other.recordings})
        ):
            return True
    return _label(first) == _label(second) and not _ids(first).isdisjoint(_ids(second))


def _no_bodies(batch: StoredBatch) -> list[StoredFruit]:
    return [fruit for fruit in batch.fruit if fruit.E_known_MPa is None]


def _label(batch: StoredBatch) -> tuple[object, ...]:
    """Folder, day, category, cultivar, lot and harvest, by which people distinguish batches."""
    return batch.folder, batch.measured, *batch.series, batch.harvest


def _ids(batch: StoredBatch) -> set[str]:
    return {*(fruit.fruit_id for fruit in batch.fruit), *batch.lost}


def _fields(kind: Any, row: Mapping[Any, Any]) -> dict[str, Any]:
    return {entry.name: row[entry.name] for entry in fields(kind) if entry.name in row}


def _cells(record: Any, table: Table) -> dict[str, Any]:
    return {name: cell for name, cell in asdict(record).items() if name in table.c}


def _sha256(batch: StoredBatch) -> str:
    return hashlib.sha256(_BATCH.dump_json(batch)).hexdigest()

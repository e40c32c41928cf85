"""A batch as a store keeps it: every result of every fruit with its revision. The latest revision counts."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from pydantic import TypeAdapter

from pipeline.history.stored_batch import StoredBatch, StoredFruit

_SEPARATE_FIELDS = frozenset({"fruit", "lost", "key", "revisions", "graded_utc"})
"""Fields of a batch that are kept in rows or columns of their own."""
_BATCH, _FRUIT = TypeAdapter(StoredBatch), TypeAdapter(StoredFruit)


@dataclass(frozen=True, kw_only=True)
class KeptRow:
    """One row: of the batch itself (`fruit_id` empty), or the result of a fruit, as JSON (null: it was not
    graded).
    """

    fruit_id: str
    revision: int
    graded_utc: str
    content: str

    @property
    def fields(self) -> dict[str, Any]:
        """What the row says; empty of a fruit that was not graded."""
        fields: dict[str, Any] = json.loads(self.content) or {}
        return fields


@dataclass(frozen=True, kw_only=True)
class KeptBatch:
    """All rows of one batch."""

    key: str
    rows: tuple[KeptRow, ...]

    @property
    def revision(self) -> int:
        """Of the rows added last, counted from 0."""
        return max(row.revision for row in self.rows)

    def latest(self) -> StoredBatch:
        """By what was graded last of the batch and of each fruit."""
        return self._of(self._in_order())

    def each(self) -> Iterator[StoredBatch]:
        """As it was after each revision."""
        rows = sorted(self.rows, key=lambda row: row.revision)
        for revision in sorted({row.revision for row in rows}):
            yield self._of([row for row in rows if row.revision <= revision])

    def renamed(self) -> dict[str, str]:
        """Fruit that have another id in later results, with that id: see `_renamed`."""
        return _renamed(self._in_order())

    def _in_order(self) -> list[KeptRow]:
        return sorted(self.rows, key=lambda row: (row.graded_utc, row.revision, row.fruit_id))

    def _of(self, rows: Sequence[KeptRow]) -> StoredBatch:
        """Later rows take the place of earlier ones, of the same id or of another that a fruit had."""
        former = _renamed(rows)
        whole = {row.fruit_id: row for row in rows if row.fruit_id not in former}
        of_batch = whole.pop("")
        return StoredBatch(
            **of_batch.fields,
            key=self.key,
            graded_utc=of_batch.graded_utc,
            fruit=tuple(StoredFruit(**row.fields) for row in whole.values() if row.fields),
            lost=tuple(name for name, row in whole.items() if not row.fields),
            revisions=self.revision,
        )

    def new_rows(self, batch: StoredBatch) -> list[KeptRow]:
        """Those of `batch`, results of the same batch, that say something new; none where all is known.

        The batch keeps its day unless its settings say another.
        """
        former = self.latest()
        if not batch.dated:
            batch = replace(batch, measured=former.measured, dated=former.dated)
        known = {(row.fruit_id, row.graded_utc, row.content) for row in self.rows}
        of_latest = {(row.fruit_id, row.content) for row in rows_of(former)}
        of_batch, *of_fruit = rows_of(batch, revision=self.revision + 1)
        fresh = [
            row
            for row in (of_batch, *of_fruit)
            if (row.fruit_id, row.content) not in of_latest
            and (row.fruit_id, row.graded_utc, row.content) not in known
        ]
        return [of_batch, *fresh] if fresh and of_batch not in fresh else fresh


def rows_of(batch: StoredBatch, *, revision: int = 0) -> list[KeptRow]:
    """The batch's own row, and one of each fruit."""
    contents: list[tuple[str, dict[str, Any] | None]] = [
        ("", _BATCH.dump_python(batch, mode="json", exclude=set(_SEPARATE_FIELDS)))
    ]
    contents += [(fruit.fruit_id, _FRUIT.dump_python(fruit, mode="json")) for fruit in batch.fruit]
    contents += [(fruit_id, None) for fruit_id in batch.lost]
    return [
        KeptRow(
            fruit_id=fruit_id,
            revision=revision,
            graded_utc=batch.graded_utc,
            content=canonical(content),
        )
        for fruit_id, content in contents
    ]


def canonical(fields: dict[str, Any] | None) -> str:
    """Fields as JSON, without those that say nothing: a field that a later drupe adds changes no SHA-256.

    >>> canonical({"lot": "7", "orchard": "", "temperature_C": 0.0, "harvest": None})
    '{"lot": "7", "temperature_C": 0.0}'
    """
    return json.dumps(_stated(fields), sort_keys=True)


def _stated(content: Any) -> Any:
    if isinstance(content, dict):
        kept = {name: _stated(inner) for name, inner in content.items()}
        return {
            name: inner
            for name, inner in kept.items()
            if inner is not False and inner not in (None, "", [], {})
        }
    return [_stated(inner) for inner in content] if isinstance(content, list | tuple) else content


def _renamed(rows: Sequence[KeptRow]) -> dict[str, str]:
    """Fruit whose recordings all reappear under another id in later results that do not know their own, with
    that id. `rows`: in the order in which later ones count.
    """
    listed = {row.revision: row.fields.get("listed", []) for row in rows if not row.fruit_id}
    earlier: dict[str, set[str]] = {}
    renamed: dict[str, str] = {}
    for row in rows:
        if not row.fruit_id:
            continue
        renamed.pop(row.fruit_id, None)
        recordings = {grasp["recording"] for grasp in row.fields.get("grasps", ()) if "recording" in grasp}
        for name, former in earlier.items():
            if name != row.fruit_id and former <= recordings and name not in listed.get(row.revision, [name]):
                renamed[name] = row.fruit_id
        if recordings:
            earlier[row.fruit_id] = recordings
    return renamed


def is_same_batch(first: StoredBatch, second: StoredBatch) -> bool:
    """Whether both are results of one batch. Either

    - a fruit of the same id has a recording in both (fruit added, another lot name or folder of results), or
    - all recordings of a fruit are those of one of another id in the other (a fruit renamed), or
    - folder, day and label are the same, and a fruit id (recordings that were calibrated again).

    Recordings of reference bodies do not count: these are in many batches.
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
    """What people tell batches apart by."""
    return batch.folder, batch.measured, *batch.series, batch.harvest


def _ids(batch: StoredBatch) -> set[str]:
    return {*(fruit.fruit_id for fruit in batch.fruit), *batch.lost}

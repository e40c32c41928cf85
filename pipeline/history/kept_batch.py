"""A batch as a store keeps it: every result of every fruit with its revision. The latest revision counts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import date
from typing import Any, TypeAlias

from pipeline.history.stored_batch import StoredBatch, StoredFruit

Content: TypeAlias = Mapping[str, Any]
"""What a row holds, as JSON has it."""
_SEPARATE_FIELDS = ("fruit", "lost", "key", "revisions", "graded_utc")
"""Fields of a batch that are kept in rows or columns of their own."""


@dataclass(frozen=True, kw_only=True)
class KeptRow:
    """One row: of the batch itself (`fruit_id` empty), or the result of a fruit (None: it was not graded)."""

    fruit_id: str
    revision: int
    graded_utc: str
    content: Content | None


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
        for revision in sorted({row.revision for row in self.rows}):
            yield self._of(sorted((r for r in self.rows if r.revision <= revision), key=lambda r: r.revision))

    def renamed(self) -> dict[str, str]:
        """Fruit that have another id in later results, with that id: see `_renamed`."""
        return _renamed(self._in_order())

    def _in_order(self) -> list[KeptRow]:
        return sorted(self.rows, key=lambda row: (row.graded_utc, row.revision))

    def _of(self, rows: Sequence[KeptRow]) -> StoredBatch:
        """Later rows take the place of earlier ones, of the same id or of another that a fruit had."""
        former = _renamed(rows)
        whole = {row.fruit_id: row for row in rows if row.fruit_id not in former}
        own = whole.pop("")
        if own.content is None:
            raise ValueError("a batch without settings")
        graded = [_fruit(row.content) for row in whole.values() if row.content is not None]
        return StoredBatch(
            **_batch_fields(own.content),
            key=self.key,
            graded_utc=own.graded_utc,
            fruit=tuple(graded),
            lost=tuple(name for name, row in whole.items() if row.content is None),
            revisions=self.revision,
        )

    def new_rows(self, batch: StoredBatch) -> list[KeptRow]:
        """Those of `batch`, results of the same batch, that say something new; none where all is known.

        The batch keeps its day unless its settings say another.
        """
        former = self.latest()
        if not batch.dated:
            batch = replace(batch, measured=former.measured, dated=former.dated)
        known = {(row.fruit_id, row.graded_utc, str(row.content)) for row in self.rows}
        of_latest = {row.fruit_id: str(row.content) for row in rows_of(former)}
        fresh = [
            row
            for row in rows_of(batch, revision=self.revision + 1)
            if str(row.content) != of_latest.get(row.fruit_id, "")
            and (row.fruit_id, row.graded_utc, str(row.content)) not in known
        ]
        if fresh and all(row.fruit_id for row in fresh):
            fresh.insert(0, rows_of(batch, revision=self.revision + 1)[0])
        return fresh


def rows_of(batch: StoredBatch, *, revision: int = 0) -> list[KeptRow]:
    """The batch's own row, and one of each fruit."""
    whole = _plain(asdict(batch))
    of_batch = {name: value for name, value in whole.items() if name not in _SEPARATE_FIELDS}
    contents: list[tuple[str, Content | None]] = [("", of_batch)]
    contents += [(one.fruit_id, _plain(asdict(one))) for one in batch.fruit]
    contents += [(name, None) for name in batch.lost]
    return [
        KeptRow(fruit_id=name, revision=revision, graded_utc=batch.graded_utc, content=content)
        for name, content in contents
    ]


def _renamed(rows: Sequence[KeptRow]) -> dict[str, str]:
    """Fruit whose recordings all reappear under another id in later results that do not know their own, with
    that id. `rows`: in the order in which later ones count.
    """
    listed = {row.revision: row.content.get("listed", ()) for row in rows if not row.fruit_id and row.content}
    recordings: dict[str, set[str]] = {}
    found: dict[str, str] = {}
    for row in rows:
        if not row.fruit_id:
            continue
        found.pop(row.fruit_id, None)
        own = set(row.content.get("recordings", ())) if row.content else set[str]()
        for name, earlier in recordings.items():
            if name != row.fruit_id and earlier <= own and name not in listed.get(row.revision, [name]):
                found[name] = row.fruit_id
        if own:
            recordings[row.fruit_id] = own
    return found


def batch_of_first_store(content: Content) -> StoredBatch:
    """A batch from the whole JSON of it that stores of the first version hold."""
    fruit = tuple(_fruit(one) for one in content["fruit"])
    said = _batch_fields(content) | {"listed": tuple(sorted(one.fruit_id for one in fruit))}
    return StoredBatch(**said, key=str(content["key"]), graded_utc=str(content["graded_utc"]), fruit=fruit)


def _batch_fields(content: Content) -> dict[str, Any]:
    """Fields that this version does not know are left out."""
    known = {one.name for one in fields(StoredBatch)} - {*_SEPARATE_FIELDS}
    return {name: value for name, value in content.items() if name in known} | {
        "measured": date.fromisoformat(content["measured"]),
        "harvest": date.fromisoformat(content["harvest"]) if content["harvest"] else None,
        "limits": tuple((str(name), limit) for name, limit in content["limits"]),
        "listed": tuple(content.get("listed", ())),
    }


def _fruit(content: Content) -> StoredFruit:
    known = {one.name for one in fields(StoredFruit)}
    own = {name: value for name, value in content.items() if name in known}
    return StoredFruit(**own | {"recordings": tuple(content.get("recordings", ()))})


def _plain(value: Any) -> Any:
    """As JSON gives it back: days as text, lists for tuples."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in sorted(value.items())}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value.isoformat() if isinstance(value, date) else value

"""What a store of `drupe history` keeps: batches with all their revisions, and conversions."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from pipeline.history.revisions import KeptBatch, is_same_batch, rows_of
from pipeline.history.scale_conversion import ScaleConversion
from pipeline.history.stored_batch import StoredBatch
from pipeline.problem import refused

NAME_LENGTH = 12
"""Hexadecimal digits of a batch's name: two of ten thousand batches are alike with a probability of 2e-7."""
SHOWN = 20
"""Batches that a sentence names, with their lots."""


class DamagedRow(NamedTuple):
    """A row whose SHA-256 differs; `batch` is empty where it belongs to no batch."""

    batch: str
    fruit_id: str
    words: str


@dataclass(kw_only=True)
class HistoryStore:
    """Batches by name and conversions by scale, cultivar and version; changes are kept when the block of
    `pipeline.history.lot_database.history_store` ends.
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

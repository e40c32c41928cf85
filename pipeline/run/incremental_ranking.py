"""The ranking of a batch whose fruit come one by one: each takes its place among those ranked so far, while
theirs is not made anew.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace

from pipeline.batch.records import FruitRecord
from pipeline.fruit.recording_owner import named_row
from pipeline.fruit.same_recording import copies_doubted
from pipeline.ranking.reference_temperature import compared
from pipeline.run.batch_run import BatchRun
from pipeline.run.packed_records import PackedRecords
from pipeline.run.reporting import entry_of
from reports.entries import BatchEntry, FruitEntry


class IncrementalRanking:
    """Takes newcomers into the `entry` that the last report made of `records`. Of those only the ones that
    bear on a newcomer are unpacked: reference bodies, and fruit with the same recording.
    """

    def __init__(self, records: PackedRecords, entry: BatchEntry) -> None:
        self.records, self.entry = records, entry
        self._holders: dict[str, set[str]] = defaultdict(set)
        self._bodies: set[str] = set()
        self._strangers: set[tuple[str, str]] = set()
        for record in records.values():
            self._note(record)

    def add(self, run: BatchRun, record: FruitRecord) -> None:
        """The entry with the newcomer: E by the reference bodies so far, in doubt where another fruit has its
        recording, and its rank.

        Other fruit's ranks and figures are those of the last report until the next, and how sure a rank is
        (`rank_probability`, `rank_low`, `rank_high`, `p_softer_than_next`) is not said of the newcomer.
        """
        self._note(record)
        related = [
            self.records[fruit_id]
            for fruit_id in sorted(self._related(record))
            if fruit_id in run.batch.row_of
        ]
        in_order, finding = compared(copies_doubted(related, run.batch.folder), run.batch.settings)
        newcomer_records = [
            related_record for related_record in in_order if related_record.fruit_id == record.fruit_id
        ]
        (fruit,) = entry_of(run)(newcomer_records, exit_status=None, finding=finding).fruits
        others = [
            entry
            for entry in self.entry.fruits
            if entry.fruit_id != fruit.fruit_id and entry.fruit_id in run.batch.row_of
        ]
        self.entry = replace(self.entry, fruits=(*others, _ranked(fruit, others)))

    def named_by_others(self, newcomers: Iterable[str]) -> list[str]:
        """Fruit that have a recording which names one of the newcomers, and may be that one's."""
        ids = set(newcomers)
        return sorted(
            {fruit_id for fruit_id, named in self._strangers if fruit_id not in ids and named_row(named, ids)}
        )

    def _note(self, record: FruitRecord) -> None:
        for grasp in record.grasps:
            if grasp.digest:
                self._holders[grasp.digest].add(record.fruit_id)
        if record.given.reference:
            self._bodies.add(record.fruit_id)
        self._strangers |= {(record.fruit_id, named) for named in record.strangers}

    def _related(self, record: FruitRecord) -> set[str]:
        """The fruit itself, the reference bodies, and all that have a recording of any of them."""
        measured = {record.fruit_id, *self._bodies} & self.records.keys()
        digests = {grasp.digest for fruit_id in measured for grasp in self.records[fruit_id].grasps}
        return measured.union(*(self._holders.get(digest, ()) for digest in digests)) & self.records.keys()


def _ranked(fruit: FruitEntry, others: Iterable[FruitEntry]) -> FruitEntry:
    """The fruit, alone in its ranking so far, with its rank among the others."""
    if fruit.rank is None or fruit.E_MPa is None:
        return fruit
    softer = sum(
        other.E_MPa < fruit.E_MPa for other in others if other.rank is not None and other.E_MPa is not None
    )
    return replace(
        fruit, rank=1 + softer, rank_probability=None, rank_low=None, rank_high=None, p_softer_than_next=None
    )

"""Merges the rows of a fruit: one id of a lot and day is the same fruit in all batches."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.history.stored_batch import StoredBatch, StoredFruit


@dataclass(frozen=True, kw_only=True)
class MergedFruit:
    """A fruit on one day: `rows` of all batches that measured it (one per gripper), `batch`: the first."""

    batch: StoredBatch
    rows: tuple[StoredFruit, ...]

    @property
    def fruit_id(self) -> str:
        """The fruit's id in all batches."""
        return self.rows[0].fruit_id

    @property
    def E_MPa(self) -> float:
        """Geometric mean of the rows' E."""
        return float(np.exp(np.mean(np.log([row.E_MPa for row in self.rows]))))

    @property
    def cheeks(self) -> tuple[tuple[float, float | None], ...]:
        """E and its standard deviation by each recording, MPa; by the row if none of its recordings has E. A
        recording in two batches counts once.
        """
        single: dict[str, tuple[float, float | None]] = {}
        for at, row in enumerate(self.rows):
            known = {
                grasp.recording or f"{at} {grasp.grasp}": (grasp.E_MPa, grasp.E_sd_MPa)
                for grasp in row.grasps
                if grasp.E_MPa is not None and grasp.E_MPa > 0
            }
            whole = {" ".join(row.recordings) or f"{at}": (row.E_MPa, row.E_sd_MPa)}
            single |= {name: E for name, E in (known or whole).items() if name not in single}
        return tuple(single.values())


def merged_fruit(batches: Sequence[StoredBatch]) -> Iterator[MergedFruit]:
    """Fruit by category, cultivar, lot, day and id, without fruit in doubt and reference bodies."""
    rows: dict[tuple[object, ...], list[tuple[StoredBatch, StoredFruit]]] = defaultdict(list)
    for batch in batches:
        for fruit in batch.fruit:
            if fruit.fitted:
                rows[*batch.series, batch.measured, fruit.fruit_id].append((batch, fruit))
    for same in rows.values():
        yield MergedFruit(batch=same[0][0], rows=tuple(fruit for _, fruit in same))

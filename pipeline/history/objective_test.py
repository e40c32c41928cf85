"""Checks whether a lot's sample suffices for the inspectors' test of firmness.

OECD Fruit and Vegetables Scheme, Guidelines on objective tests (2018): at least ten fruit of each size, drawn
at random, and firmness on two opposite sides of each fruit. E replaces the penetrometer's reading.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from pipeline.history.merged_fruit import MergedFruit, merged_fruit
from pipeline.history.softening import pooled_sd
from pipeline.history.stored_batch import StoredBatch
from reports.history_entries import LotName, ObjectiveSampleEntry

FRUIT, CHEEKS = 10, 2
"""Fewest fruit of each size, and fewest cheeks of each fruit."""
BOTH_CHEEKS = "Each fruit has two recorded cheeks: the sample suffices"
TURNED = "If each fruit was turned between two recordings, the sample suffices"


def objective_samples(
    batches: Sequence[StoredBatch], cheeks_per_recording: int, *, size_column: str = ""
) -> Iterator[ObjectiveSampleEntry]:
    """The sample of each cultivar, lot, day and size, in this order, without fruit in doubt and bodies.

    `cheeks_per_recording`: sides that one recording presses and measures. `size_column`: the user's column
    with the size; without it, all fruit of a lot have one size.
    """

    def of_size(fruit: MergedFruit) -> LotName:
        stated = (str(row.columns[size_column]) for row in fruit.rows if size_column in row.columns)
        return replace(fruit.batch.lot_day, size=next(stated, "") if size_column else None)

    for name, group in groupby(sorted(merged_fruit(batches), key=of_size), key=of_size):
        yield _sample(name, list(group), cheeks_per_recording)


def _sample(name: LotName, fruit: Sequence[MergedFruit], per_recording: int) -> ObjectiveSampleEntry:
    cheeks = [(specimen.fruit_id, specimen.cheeks) for specimen in fruit]
    lacking = [(fruit_id, left) for fruit_id, E in cheeks if (left := CHEEKS - per_recording * len(E)) > 0]
    missing = max(FRUIT - len(fruit), 0)
    sentences = [f"{len(fruit)} fruit, at least {FRUIT} are needed"]
    if missing:
        sentences.append(f"Grade {missing} more fruit")
    if lacking:
        number = sum(left for _, left in lacking)
        sentences.append(f"{number} cheeks of {len(lacking)} fruit are missing")
    if not missing and not lacking:
        sentences.append(TURNED if per_recording < CHEEKS else BOTH_CHEEKS)
    sentences += _difference([[E for E, _ in both] for _, both in cheeks if len(both) > 1])
    return ObjectiveSampleEntry(
        name=name,
        fruit=len(fruit),
        fruit_missing=missing,
        cheeks_missing=tuple(f"{fruit_id} ({left})" for fruit_id, left in lacking),
        words=". ".join(sentences),
        cheeks=tuple(cheeks),
    )


def _difference(E_MPa: Sequence[Sequence[float]]) -> Iterator[str]:
    """A clause with the pooled standard deviation of ln E within fruit, if there are repeats."""
    if E_MPa:
        sd = 100 * pooled_sd([np.log(E) for E in E_MPa])
        yield f"E of single recordings of {len(E_MPa)} fruit differs within a fruit by {sd:.1f} % (sd)"

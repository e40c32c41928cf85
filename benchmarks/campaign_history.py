"""What becomes of results in `drupe history`: damaged ones, revised ones, and lots that are formulas.

    python benchmarks/campaign_history.py RESULTS [--flips N]

RESULTS is a folder of `drupe grade`, which stays as it is. Prints for each kind of file how many flipped bits
were refused by the file's name, how many left what is read as it was, and how many changed it: FAILED. Then,
for each way in which results are revised, how many fruit count and how many should; and for each lot the cell
of the table. Every other number or cell is a failure.
"""

import argparse
import csv
import io
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np

from pipeline.history.history_store import history_store
from pipeline.history.history_table import history_csv
from pipeline.history.stored_batch import StoredBatch, stored_batch
from pipeline.problem import BatchRefused


def flipped(data: bytes, place: int) -> bytes:
    """The same with one bit changed."""
    changed = bytearray(data)
    changed[place // 8] ^= 1 << (place % 8)
    return bytes(changed)


def verdict(path: Path, read: Callable[[], object], sound: object) -> str:
    """What comes of a damaged file: it is named, read as it was, or used as it is (FAILED)."""
    try:
        return "as it was" if read() == sound else "FAILED"
    except BatchRefused as refused:
        return "named" if str(path.parent) in str(refused) else "FAILED"


def counted(path: Path, read: Callable[[], object], *, flips: int, rng: np.random.Generator) -> Counter[str]:
    """Verdicts over so many flips of one file, which is sound again at the end."""
    data, sound = path.read_bytes(), read()
    found: Counter[str] = Counter()
    for place in rng.integers(0, 8 * len(data), flips):
        path.write_bytes(flipped(data, int(place)))
        found[verdict(path, read, sound)] += 1
    path.write_bytes(data)
    return found


def batches_in(store: Path) -> Sequence[StoredBatch]:
    """What a store says."""
    with history_store(store) as kept:
        return kept.batches()


def _named(batch: StoredBatch, ids: Callable[[str], str]) -> StoredBatch:
    """The same with other ids."""
    fruit = tuple(replace(one, fruit_id=ids(one.fruit_id)) for one in batch.fruit)
    return replace(batch, fruit=fruit, listed=tuple(map(ids, batch.listed)))


def _with_a_fruit_more(batch: StoredBatch) -> StoredBatch:
    one = replace(batch.fruit[0], fruit_id="one-more", recordings=("of its own",))
    return replace(batch, fruit=(*batch.fruit, one), listed=(*batch.listed, "one-more"))


def _recalibrated(batch: StoredBatch) -> StoredBatch:
    fruit = tuple(
        replace(one, E_MPa=1.1 * one.E_MPa, recordings=(f"anew {one.fruit_id}",)) for one in batch.fruit
    )
    return replace(batch, fruit=fruit)


def _one_renamed(batch: StoredBatch) -> StoredBatch:
    first = batch.fruit[0].fruit_id
    return _named(batch, lambda name: "renamed" if name == first else name)


REVISIONS: dict[str, tuple[Callable[[StoredBatch], StoredBatch], Callable[[int], int]]] = {
    "graded again": (lambda batch: batch, lambda n: n),
    "a fruit added": (_with_a_fruit_more, lambda n: n + 1),
    "recordings recalibrated": (_recalibrated, lambda n: n),
    "lot corrected": (lambda batch: replace(batch, lot=f"{batch.lot} corrected"), lambda n: n),
    "a fruit renamed": (_one_renamed, lambda n: n),
    "all fruit renamed": (lambda batch: _named(batch, lambda name: f"B-{name}"), lambda n: n),
    "a fruit removed": (
        lambda batch: replace(batch, fruit=batch.fruit[1:], listed=batch.listed[1:]),
        lambda n: n,
    ),
    "another day": (
        lambda batch: replace(_recalibrated(batch), measured=batch.measured + timedelta(2)),
        lambda n: 2 * n,
    ),
}
"""By name, the later results of a batch and how many fruit then count, of so many at first."""
LOTS = {
    ";=cmd|' /C calc'!A0": ";'=cmd|' /C calc'!A0",
    "=cmd|' /C calc'!A0": "'=cmd|' /C calc'!A0",
    "7;=cmd|' /C calc'!A0": "7;'=cmd|' /C calc'!A0",
    "7, -1+cmd|' /C calc'!A0": "7,' -1+cmd|' /C calc'!A0",
    "offset (0.1, -0.3) mm": "offset (0.1, -0.3) mm",
    "lot A,-7": "lot A,-7",
}
"""Names of lots, each with its cell in tables."""


def counted_after(batch: StoredBatch, revision: str) -> tuple[int, int]:
    """How many fruit count after that revision, each as the latest results have it, and how many should."""
    revise, expected = REVISIONS[revision]
    later = replace(revise(batch), key="later", graded_utc=f"{batch.graded_utc[:4]}-12-31T23:59:59Z")
    with history_store(None) as store:
        for one in (batch, later, batch):
            store.add(one)
        found = [one for kept in store.batches() for one in kept.fruit]
    latest = sum(one in found for one in later.fruit) == len(later.fruit)
    return (len(found) if latest else -1), expected(len(batch.fruit))


def lot_cell(batch: StoredBatch, lot: str) -> str:
    """The cell of that lot in the table of the history."""
    table = history_csv([replace(batch, lot=lot)], {})
    return next(csv.DictReader(io.StringIO(table)))["lot"]


def main() -> None:
    """Prints the tables; exit status 1 where a damaged file was used, a number or a cell is another."""
    parser = argparse.ArgumentParser()
    parser.add_argument("results", type=Path)
    parser.add_argument("--flips", type=int, default=150)
    options = parser.parse_args()
    rng, failed = np.random.default_rng(0), 0
    with tempfile.TemporaryDirectory() as scratch:
        out, store = Path(scratch) / "results", Path(scratch) / "lots.sqlite"
        shutil.copytree(options.results, out)
        with history_store(store) as kept:
            kept.add(stored_batch(out))
        record = next(out.glob("fruits/*/record.json"))
        kinds: dict[Path, Callable[[], object]] = {
            path: lambda: stored_batch(out)
            for path in (out / "batch.json", record, out / ".written.json", record.with_name(".written.json"))
        }
        kinds[store] = lambda: batches_in(store)
        print("| file | named | as it was | FAILED |\n|---|---:|---:|---:|")
        for path, read in kinds.items():
            found = counted(path, read, flips=options.flips, rng=rng)
            failed += found["FAILED"]
            name = path.relative_to(scratch).as_posix()
            print(f"| {name} | {found['named']} | {found['as it was']} | {found['FAILED']} |")
    print("\n| revision | fruit that count | expected |\n|---|---:|---:|")
    batch = stored_batch(options.results)
    for name in REVISIONS:
        found_count, expected = counted_after(batch, name)
        failed += found_count != expected
        print(f"| {name} | {found_count} | {expected} |")
    print("\n| lot | cell | expected |\n|---|---|---|")
    for lot, cell in LOTS.items():
        failed += lot_cell(batch, lot) != cell
        print("| " + " | ".join(one.replace("|", "\\|") for one in (lot, lot_cell(batch, lot), cell)) + " |")
    print(f"\n{failed} failures")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

"""Damaged results and stores, one flipped bit at a time: `drupe history` uses none of them without a message.

    python benchmarks/campaign_history.py RESULTS [--flips N]

RESULTS is a folder of `drupe grade`, which stays as it is. Prints for each kind of file how many flips were
refused by the file's name, how many left what is read as it was, and how many changed it: FAILED.
"""

import argparse
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pipeline.history.history_store import history_store
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


def main() -> None:
    """Prints the table; exit status 1 where a damaged file was used."""
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
    print(f"\n{failed} failures")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

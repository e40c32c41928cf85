"""Sizes and times of the report of many fruit, made by the report's own functions from graded ones.

    python benchmarks/report_sizes.py BATCH RESULTS [--fruits 4 500 2000] [--keep DIR] [--failed 0.02]

BATCH is a batch whose results `drupe grade` left in RESULTS. Its records are taken again and again under
other ids with E drawn from a lognormal distribution about theirs; pictures are the fruit's own. A share of
them is said not to be graded. `--keep` leaves the pages for a look.
"""

import argparse
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import Results
from pipeline.batch.opening import Batch, open_batch
from pipeline.batch.records import FruitRecord, read_record
from pipeline.batch.settings import Grading, GradingClass
from pipeline.ranking.report_entries import batch_entry
from pipeline.ranking.report_pictures import ReportPictures
from reports.page import report_html
from reports.tables import ranking_csv

SPREAD = 0.35
"""Standard deviation of ln E of the drawn fruit."""
CLASSES = (("ready to eat", 0.35), ("ready to ship", 0.7), ("unripe", None))


def enlarged(
    batch: Batch, records: list[FruitRecord], count: int, failed: float
) -> tuple[Batch, list[FruitRecord]]:
    """The batch with so many fruit."""
    rng = np.random.default_rng(7)
    rows, many = [], []
    for k in range(count):
        one, name = records[k % len(records)], f"L{1 + k // 100:02d}-{k % 100:03d}"
        assert one.modulus is not None
        factor = float(np.exp(SPREAD * rng.normal()))
        modulus = one.modulus.model_copy(
            update={"E_MPa": one.modulus.E_MPa * factor, "E_sd_MPa": one.modulus.E_sd_MPa * factor}
        )
        update: dict[str, object] = {"fruit_id": name, "modulus": modulus}
        if rng.random() < failed:
            update |= {"outcome": "never-touches", "reason": f"grasp-1 never touches {name}."}
        many.append(one.model_copy(update=update))
        rows.append(FruitRow(fruit_id=name))
    grading = Grading(classes=tuple(GradingClass(name=n, E_max_MPa=E) for n, E in CLASSES))
    settings = batch.settings.model_copy(update={"grading": grading})
    return replace(batch, rows=tuple(rows), settings=settings), many


class BorrowedPictures(ReportPictures):
    """Pictures of the fruit that a record was copied from."""

    def __init__(self, results: Results, ids: list[str], *, fruits: int) -> None:
        super().__init__(results, fruits=fruits)
        self._results, self._ids = results, ids

    def of(self, files, *, measured, graded, explained=False):  # noqa: D102
        group, _, number = files.root.name.partition("-")
        index = (int(group[1:]) - 1) * 100 + int(number)
        own = self._results.fruit(self._ids[index % len(self._ids)])
        return super().of(own, measured=measured, graded=graded, explained=explained)


def main() -> None:
    """A line per number of fruit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("batch", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--fruits", type=int, nargs="+", default=[4, 500, 2000])
    parser.add_argument("--failed", type=float, default=0.02)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    batch, results = open_batch(options.batch), Results(options.results)
    found = [read_record(results.fruit(row.fruit_id).record) for row in batch.rows]
    records = [one for one in found if one is not None and one.graded]
    print("fruit   page MB   kB a fruit   entries s   page s   csv s")
    for count in options.fruits:
        large, many = enlarged(batch, records, count, options.failed)
        pictures = BorrowedPictures(results, [one.fruit_id for one in records], fruits=count)
        now = datetime(2026, 8, 14, tzinfo=UTC)
        start = time.perf_counter()
        entry = batch_entry(
            large,
            many,
            results=results,
            inputs={},
            started=now,
            finished=now,
            exit_status=0,
            pictures=pictures,
        )
        entries_s = time.perf_counter() - start
        start = time.perf_counter()
        page = report_html(entry)
        page_s = time.perf_counter() - start
        start = time.perf_counter()
        ranking_csv(entry)
        csv_s = time.perf_counter() - start
        size = len(page.encode())
        print(
            f"{count:5d}   {size / 1e6:7.2f}   {size / 1e3 / count:10.1f}   {entries_s:9.2f}   "
            f"{page_s:6.2f}   {csv_s:5.2f}",
            flush=True,
        )
        if options.keep is not None:
            (options.keep / f"report-{count}.html").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()

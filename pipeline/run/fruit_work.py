"""What a fruit's process does for a run: it grades the fruit, and makes the small pictures of it that the
report holds, which would else be made one fruit after the other at the end.

The process that hands out fruit names `work_on` and never runs it: what the work needs is imported by the
work.
"""

import gc
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from pipeline.safe_start import uncollected

if TYPE_CHECKING:
    from pipeline.batch.records import FruitRecord
    from pipeline.batch.task import FruitTask


def work_on(task: "FruitTask", report: Callable[[str], None]) -> "FruitRecord":
    """The fruit's record, which is written, as its small pictures are."""
    with uncollected():
        from pipeline.fruit.lean_open3d import load_open3d

        load_open3d()
        from pipeline.fruit.stages import grade_fruit

    gc.freeze()  # what was imported stays until the process ends: it is not looked through for garbage
    record = grade_fruit(task, report)
    keep_pictures(task, record)
    return record


def keep_pictures(task: "FruitTask", record: "FruitRecord") -> None:
    """Makes the report's pictures of the fruit; where that fails the report itself says so."""
    from pipeline.batch.layout import Results
    from pipeline.ranking.report_pictures import ReportPictures

    fruits = 1 if task.batch_fruits is None else len(task.batch_fruits)
    pictures = ReportPictures(Results(task.results.root.parents[1]), fruits=fruits)
    with suppress(OSError, ValueError):
        pictures.of(task.results, measured=record.mesh is not None)

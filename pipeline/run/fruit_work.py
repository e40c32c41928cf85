"""What a fruit's process does for a run: it grades the fruit, and makes the small pictures of it that the
report holds, which would else be made one fruit after the other at the end.
"""

from collections.abc import Callable
from contextlib import suppress

from pipeline.batch.layout import Results
from pipeline.batch.records import FruitRecord
from pipeline.batch.task import FruitTask
from pipeline.fruit.stages import grade_fruit
from pipeline.ranking.report_pictures import ReportPictures


def work_on(task: FruitTask, report: Callable[[str], None]) -> FruitRecord:
    """The fruit's record, which is written, as its small pictures are."""
    record = grade_fruit(task, report)
    keep_pictures(task, record)
    return record


def keep_pictures(task: FruitTask, record: FruitRecord) -> None:
    """Makes the report's pictures of the fruit; where that fails the report itself says so."""
    fruits = 1 if task.batch_fruits is None else len(task.batch_fruits)
    pictures = ReportPictures(Results(task.results.root.parents[1]), fruits=fruits)
    with suppress(OSError, ValueError):
        pictures.of(task.results, measured=record.mesh is not None, graded=record.graded)

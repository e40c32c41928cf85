"""What a fruit's process does for a run: it grades the fruit.

The process that hands out fruit names `work_on` and never runs it: what the work needs is imported by the
work.
"""

import gc
from collections.abc import Callable
from typing import TYPE_CHECKING

from pipeline.safe_start import uncollected

if TYPE_CHECKING:
    from pipeline.batch.records import FruitRecord
    from pipeline.batch.task import FruitTask


def work_on(task: "FruitTask", report: Callable[[str], None]) -> "FruitRecord":
    """The fruit's record, which is written."""
    with uncollected():
        from pipeline.fruit.stages import grade_fruit

    gc.freeze()  # what was imported stays until the process ends: it is not looked through for garbage
    return grade_fruit(task, report)

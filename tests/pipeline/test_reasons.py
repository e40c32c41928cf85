"""Why a fruit is not graded names files as people look for them: from the batch's folder on."""

import pytest
from small_batches import empty_batch

from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.outcome import Outcome
from pipeline.batch.task import fruit_task
from pipeline.fruit.stages import grade_fruit
from pipeline.run.fruit_queue import ended_record


@pytest.fixture
def task(tmp_path):
    root = empty_batch(tmp_path / "monday", "A", table="fruit_id,height_mm\nA,56\n")
    return fruit_task(open_batch(root), "A", Results(root / "results"))


def test_the_fruits_own_files_are_named_from_the_batchs_folder_on(task):
    reason = grade_fruit(task, lambda _: None).reason
    assert reason.startswith("fruits/A holds neither photos nor fruit.ply")
    task.folder.fruit_ply.write_text("ply of nothing")
    assert grade_fruit(task, lambda _: None).reason.startswith("fruits/A/fruit.ply is broken")


def test_a_file_outside_the_batch_keeps_its_whole_path(task, tmp_path):
    inside, outside = task.batch_root / "results" / "one.png", f"/mnt{task.batch_root}/one.png"
    said = ended_record(task, Outcome.NOT_WRITTEN, f"{outside} and {inside}: No space left on device.").reason
    assert f"{outside} and results/one.png: No space" in said


@pytest.mark.parametrize("before", ["", "of ", "(", '"', "'", "[", "`", "file:", "path=", "['"])
def test_a_file_is_named_from_the_folder_on_whatever_mark_stands_before_it(task, before):
    said = task.named_in_batch(f"{before}{task.batch_root}/fruits/A/one.png")
    assert said == f"{before}fruits/A/one.png"

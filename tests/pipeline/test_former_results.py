"""Results of one batch are not replaced by another's; the same batch is known wherever its folder lies."""

import json
import shutil

import pytest
from graded_results import rows, work_at_once, written
from rich.console import Console
from small_batches import contents

from pipeline.diagnosis.explaining import ExplainOutputs, explain
from pipeline.problem import BatchRefused
from pipeline.run import grading as grading
from pipeline.run.batch_run import GradeOptions

IDS = ("01", "02", "03", "04", "05")


@pytest.fixture
def grade(monkeypatch):
    """Grades a batch; the work on a fruit is replaced by one that gives a modulus at once."""
    monkeypatch.setattr(grading, "_work", work_at_once(lambda _, task: written(task, 0.5)))

    def run(batch, out):
        how = GradeOptions(jobs=1, time_limit_s=60)
        return grading.grade(batch, out, how, console=Console(quiet=True))[0]

    return run


def make_batch(root, day, ids=IDS, settings=""):
    """A batch whose photos and recordings are of `day`; the cast body's mesh is of every day."""
    for name in ids:
        (root / "fruits" / name / "photos").mkdir(parents=True)
        (root / "fruits" / name / "grasps").mkdir()
        (root / "fruits" / name / "fruit.ply").write_text("the mould's mesh")
        (root / "fruits" / name / "photos" / "0.jpg").write_text(f"photo of {name}, {day}")
        (root / "fruits" / name / "grasps" / "grasp-1.h5").write_text(f"grasp of {name}, {day}")
    (root / "batch.toml").write_text(f'category = "nectarine"\n{settings}')
    (root / "fruits.csv").write_text("".join(f"{row}\n" for row in ("fruit_id", *ids)))
    return root


@pytest.mark.parametrize("ids", [IDS, ("11", "12", "13")], ids=["same ids", "other ids"])
def test_results_of_another_batch_are_not_replaced(grade, tmp_path, ids):
    out = tmp_path / "out"
    grade(make_batch(tmp_path / "monday", "Monday"), out)
    before = contents(out)
    with pytest.raises(BatchRefused) as refused:
        grade(make_batch(tmp_path / "tuesday", "Tuesday", ids), out)
    said = str(refused.value)
    assert said.startswith(
        f"{out}: holds the results of another batch in {tmp_path / 'monday'} "
        "(fruit 01, 02, 03 and 2 more), with other photos and recordings. They are not replaced; "
        "choose another folder with --out, or move this one away"
    )
    assert contents(out) == before


def test_results_inside_a_batch_move_with_it_and_are_not_a_copied_templates(grade, tmp_path):
    monday = make_batch(tmp_path / "monday", "Monday")
    grade(monday, None)
    tuesday = tmp_path / "tuesday"
    shutil.copytree(monday, tuesday)
    assert grade(tuesday, None) == 0
    shutil.copytree(monday / "results", tuesday / "results", dirs_exist_ok=True)
    shutil.rmtree(tuesday / "fruits")
    make_batch(tuesday, "Tuesday")
    with pytest.raises(BatchRefused, match=f"another batch in {monday}"):
        grade(tuesday, None)


@pytest.mark.parametrize("name", ["monday", "copy of monday"])
def test_a_batch_that_was_moved_or_renamed_keeps_its_results(grade, tmp_path, name):
    out = tmp_path / "out"
    monday = make_batch(tmp_path / "monday", "Monday")
    grade(monday, out)
    moved = tmp_path / "elsewhere" / name
    shutil.move(monday, moved)
    assert grade(moved, out) == 0
    assert json.loads((out / "batch.json").read_text())["batch"] == str(moved)


def test_a_batch_in_its_own_folder_may_gain_lose_and_replace_fruit(grade, tmp_path):
    monday = make_batch(tmp_path / "monday", "Monday")
    grade(monday, None)
    (monday / "fruits.csv").write_text("fruit_id\n02\n03\n")
    assert grade(monday, None) == 0
    make_batch(tmp_path / "again", "Monday, all measured anew")
    shutil.copytree(tmp_path / "again", monday, dirs_exist_ok=True)
    assert grade(monday, None) == 0
    assert set(rows(monday / "results")) == set(IDS)


def test_a_batch_whose_results_moved_inside_it_may_lose_fruit(grade, tmp_path):
    monday = make_batch(tmp_path / "monday", "Monday")
    grade(monday, None)
    moved = tmp_path / "copy"
    shutil.copytree(monday, moved)
    (moved / "fruits.csv").write_text("fruit_id\n02\n03\n")
    assert grade(moved, None) == 0
    assert set(rows(moved / "results")) == {"02", "03"}


def test_a_folder_used_again_for_another_lot_does_not_replace_the_first_lots_results(grade, tmp_path):
    today = make_batch(tmp_path / "today", "Monday", settings='lot = "A"\n')
    grade(today, tmp_path / "out")
    shutil.rmtree(today)
    make_batch(today, "Tuesday", settings='lot = "B"\n')
    with pytest.raises(BatchRefused, match="with other photos and recordings"):
        grade(today, tmp_path / "out")
    (today / "batch.toml").write_text('category = "nectarine"\nlot = "A"\n')  # was it a slip? then it is A
    assert grade(today, tmp_path / "out") == 0


def test_what_a_killed_first_run_made_is_known_too(grade, tmp_path, monkeypatch):
    out = tmp_path / "out"

    def killed(*_, **__):
        raise SystemExit(9)

    with monkeypatch.context() as patch:
        patch.setattr(grading, "_work", killed)
        with pytest.raises(SystemExit):
            grade(make_batch(tmp_path / "monday", "Monday"), out)
    begun = json.loads((out / "batch.json").read_text())
    assert (begun["exit_status"], begun["finished_utc"]) == (None, None)
    with pytest.raises(BatchRefused, match="another batch"):
        grade(make_batch(tmp_path / "tuesday", "Tuesday"), out)
    assert grade(tmp_path / "monday", out) == 0


def test_an_answer_is_not_put_among_another_batchs_results(grade, tmp_path):
    out = tmp_path / "out"
    grade(make_batch(tmp_path / "monday", "Monday"), out)
    tuesday, before = make_batch(tmp_path / "tuesday", "Tuesday"), contents(out)
    with pytest.raises(BatchRefused, match="another batch"):
        explain(tuesday, fruit_id="01", wanted=ExplainOutputs(out=out), report=lambda _: None)
    assert contents(out) == before

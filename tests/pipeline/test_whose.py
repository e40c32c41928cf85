"""Recordings and results of another fruit or batch are refused or in doubt."""

import json
import math
import shutil
from dataclasses import replace
from unittest import mock

import h5py
import pytest
from explain_runs import NO_MESH
from graded_results import graded, rows, work_at_once, written
from raw_folder import write_raw
from rich.console import Console
from small_batches import batch_of_nectarines, contents, run, said_with

import pipeline.fruit.grasped
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import ModulusRecord, ScreenRecord
from pipeline.batch.task import fruit_task
from pipeline.diagnosis.explaining import ExplainOutputs, explain
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.recording_owner import Owner, copies_doubted, owner_findings, stranger
from pipeline.fruit.stage_log import StageLog
from pipeline.problem import BatchRefused
from pipeline.run import grading as grading
from pipeline.run.batch_run import GradeOptions
from pipeline.run.fruit_queue import kept_record
from reports.grasp_record import GraspRecord
from tactile.readers.recording import read_recording, recording_digest
from tactile.tactile_failure import TactileFailure, TactileProblem


def relabel(path, **attributes):
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)


@pytest.fixture
def batch(tmp_path):
    """Two fruit with a recording each that names its own."""
    settings = 'category = "nectarine"\npoisson_ratio = 0.45\n[mesh]\nedge_mm = 8.0\npad_edge_mm = 3.0\n'
    return batch_of_nectarines(tmp_path, "N02", "N04", pit=True, settings=settings)


def recording(batch, fruit="N02"):
    return batch / "fruits" / fruit / "grasps" / "grasp-1.h5"


def checked(batch):
    status, text = run("check", batch)
    return status, text.replace(f"{batch}/", "")


def prepared(batch, fruit="N02"):
    """The fruit without its elements, and the log."""
    log = StageLog(lambda stage: None)
    task = fruit_task(open_batch(batch), fruit, Results(batch / "results"))
    task.results.claim()
    with mock.patch.object(pipeline.fruit.grasped, "flesh_mesh", return_value=NO_MESH):
        return grasped_fruit(task, log), log


REFUSED = (
    'attribute fruit_id: found "N04", expected "N02": the recording belongs to another fruit of this batch. '
    "Move the file to fruits/N04/grasps, or correct the attribute fruit_id if the recording is of N02."
)
DOUBTED = 'attribute fruit_id: found "N77", expected "N02", and fruits.csv has no "N77"'


def test_check_and_grading_and_explain_refuse_the_recording_of_another_fruit_of_the_batch(batch):
    relabel(recording(batch), fruit_id="N04")
    status, text = checked(batch)
    assert status == 2
    assert f"fruits/N02/grasps/grasp-1.h5: {REFUSED}" in text
    text = said_with(3, "explain", batch, "--fruit", "N02")
    assert REFUSED in " ".join(text.split())
    with pytest.raises(TactileFailure) as refused:
        prepared(batch)
    assert refused.value.problem is TactileProblem.FOREIGN_RECORDING
    assert refused.value.detail == f"grasp-1: {REFUSED}"


def test_a_refused_one_costs_no_other_recording(batch):
    shutil.copyfile(recording(batch, "N04"), recording(batch).with_name("grasp-2.h5"))
    fruit, log = prepared(batch)
    assert [grasp.name for grasp in fruit.placed] == ["grasp-1"]
    assert log.facts.strangers == {"N04": True}
    assert fruit.doubts == ()
    assert any(said.startswith("not used: grasp-2: attribute fruit_id") for said in log.warnings)


def test_an_id_that_the_batch_does_not_have_puts_E_in_doubt(batch):
    relabel(recording(batch), fruit_id="N77")
    status, text = checked(batch)
    assert status == 4
    assert DOUBTED in text
    fruit, log = prepared(batch)
    (doubt,) = fruit.doubts
    assert DOUBTED in doubt.sentence
    assert doubt.relative_sd == pytest.approx(0.35)
    assert log.warnings[0] == doubt.sentence


@pytest.mark.parametrize("said", ["", "unknown", "N02", " n02", "N2", "n-02", "N 2", "n_002"])
def test_a_recording_that_names_its_own_fruit_in_any_spelling_or_none_is_not_doubted(said):
    owner = Owner(fruit_id="N02", category="nectarine", batch_fruits=("N02", "N04"))
    assert owner_findings(said, "nectarine", owner, source="g", field="attribute fruit_id") == []


def test_another_known_category_puts_E_in_doubt_and_one_of_the_users_own_does_not(batch):
    relabel(recording(batch), category="plum")
    status, text = checked(batch)
    assert status == 4
    assert 'category: found "plum", expected "nectarine" as in batch.toml' in text
    assert ["plum" in doubt.sentence for doubt in prepared(batch)[0].doubts] == [True]
    relabel(recording(batch), category="our early nectarine")
    assert checked(batch)[0] == 0
    assert prepared(batch)[0].doubts == ()


@pytest.mark.parametrize(
    ("named", "rows", "who"),
    [
        ("1", ("01", "02"), None),
        ("2", ("01", "02"), "02"),
        ("001", ("01", "001"), "001"),
        ("1", ("01", "001"), "1"),  # of either
        ("1-1", ("01", "11"), "1-1"),
        ("10", ("01", "100"), "10"),
    ],
)
def test_zeros_before_a_number_make_no_other_fruit_unless_the_batch_has_both(named, rows, who):
    assert stranger(named, Owner(fruit_id="01", batch_fruits=rows)) == who


def test_a_case_of_its_own_may_be_called_otherwise():
    assert (
        owner_findings("N77", "plum", Owner(fruit_id="case-1"), source="g", field="attribute fruit_id") == []
    )


def test_a_kept_record_holds_only_while_the_batch_has_the_same_strangers(batch):
    task = fruit_task(open_batch(batch), "N02", Results(batch / "results"))
    changes = {"key": task.key, "strangers": {"N77": False}, "screen": ScreenRecord(p_value=0.5)}
    record = graded("N02", 0.5, changes=changes)
    assert kept_record(task, record, ["N02"]) == record
    assert kept_record(task, record, ["N02", "N77"]) is None
    assert kept_record(task, record, ["N02", "n-77"]) is None


def test_check_says_it_of_a_raw_grasp(batch):
    raw = write_raw(recording(batch).with_name("raw-1"), frames=4)
    text = (raw / "grasp.toml").read_text()
    (raw / "grasp.toml").write_text(text.replace('fruit_id = "f1"', 'fruit_id = "N04"'))
    status, said = checked(batch)
    assert status == 2
    assert 'raw-1: fruit_id in grasp.toml: found "N04", expected "N02"' in said
    (raw / "grasp.toml").write_text(text)
    status, said = checked(batch)
    assert status == 4
    assert 'raw-1: fruit_id in grasp.toml: found "f1", expected "N02", and fruits.csv has no "f1"' in said


def test_a_copy_within_a_fruit_counts_once(batch):
    """Written again in double precision, with another attribute: other bytes, and the same grasp."""
    copy = recording(batch).with_name("grasp-2.h5")
    shutil.copyfile(recording(batch), copy)
    with h5py.File(copy, "r+") as file:
        file.attrs["sensor"] = "of another name"
        force = file["pads/left/force_N"][()].astype(float)
        del file["pads/left/force_N"]
        file["pads/left/force_N"] = force
    assert copy.read_bytes() != recording(batch).read_bytes()
    said = "contains the same displacements and forces as grasp-1.h5, so drupe counts one grasp"
    status, text = checked(batch)
    assert status == 2
    assert f"fruits/N02/grasps/grasp-2.h5: {said}" in text
    fruit, log = prepared(batch)
    assert [grasp.name for grasp in fruit.placed] == ["grasp-1"]
    assert any(
        warning.startswith("not used: grasp-2: contains the same displacements and forces as grasp-1")
        for warning in log.warnings
    )


def test_a_recording_of_two_fruit_puts_both_in_doubt(batch):
    shutil.copyfile(recording(batch, "N04"), recording(batch))
    relabel(recording(batch), fruit_id="N02")
    status, text = checked(batch)
    assert status == 4
    first, second, _ = text.splitlines()
    words = "contains the same displacements and forces as fruits/{}/grasps/grasp-1.h5. At least one"
    assert first.startswith(f"fruits/N02/grasps/grasp-1.h5: {words.format('N04')}")
    assert second.startswith(f"fruits/N04/grasps/grasp-1.h5: {words.format('N02')}")


def with_grasps(name, *digests, outcome="graded"):
    grasps = tuple(GraspRecord(grasp=f"grasp-{k}", digest=digest) for k, digest in enumerate(digests, 1))
    modulus = ModulusRecord(E_MPa=0.5, E_sd_MPa=0.03, common_sd_MPa=0.01, parts_sd_MPa={"noise": 0.03})
    changes = {"outcome": outcome, "grasps": grasps, "modulus": modulus, "warnings": ("w",)}
    return graded(name, 0.5, changes=changes)


def test_grading_doubts_both_by_what_fruit_of_a_lot_differ(batch):
    """One of two recordings is shared: half of E's 35 % is in doubt."""
    sound, refused = with_grasps("N05", "c"), with_grasps("N06", "a", outcome="no-shape")
    first, other, *rest = copies_doubted(
        [with_grasps("N02", "a", "b"), with_grasps("N04", "a"), sound, refused], BatchFolder(batch)
    )
    assert rest == [sound, refused]
    for record, there, sd in ((first, "N04", 0.5 * 0.35), (other, "N02", 0.35)):
        (doubt,) = record.doubts
        expected = f"grasp-1: contains the same displacements and forces as fruits/{there}/grasps/grasp-1.h5"
        assert doubt.startswith(expected)
        assert record.warnings == (doubt, "w")
        assert record.modulus.E_MPa == 0.5
        assert record.modulus.E_sd_MPa == pytest.approx(math.hypot(0.03, 0.5 * sd))
        assert math.hypot(*record.modulus.parts_sd_MPa.values()) == pytest.approx(record.modulus.E_sd_MPa)
        assert record.modulus.common_sd_MPa == 0.01


def test_two_recordings_are_one_only_where_every_value_is(batch):
    recording_a, other = read_recording(recording(batch)), read_recording(recording(batch, "N04"))
    assert recording_digest(recording_a) != recording_digest(other)
    left, right = recording_a.pads
    exchanged = (replace(right, name="left"), replace(left, name="right"))
    assert recording_digest(replace(recording_a, fruit_id="x", pads=exchanged)) == recording_digest(
        recording_a
    )
    felt = left.displacement_mm.copy()
    felt[-1, -1, 0] += 1e-4
    moved = replace(recording_a, pads=(replace(left, displacement_mm=felt), right))
    assert recording_digest(moved) != recording_digest(recording_a)


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

"""A recording of another fruit is no recording of this one: refused, or its E is in doubt."""

import math
import shutil
from dataclasses import replace
from unittest import mock

import h5py
import pytest
from explain_runs import NO_MESH
from graded_results import graded
from raw_folder import write_raw
from small_batches import batch_of_nectarines, run

import pipeline.fruit.grasped
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import ModulusRecord, ScreenRecord
from pipeline.batch.task import fruit_task
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.recording_owner import Owner, copies_doubted, owner_findings, stranger
from pipeline.fruit.stage_log import StageLog
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
    status, text = run("explain", batch, "--fruit", "N02")
    assert status == 3
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

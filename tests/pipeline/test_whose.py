"""A recording of another fruit is no recording of this one: refused, or its E is in doubt."""

import shutil
import sys
from pathlib import Path

import h5py
import pytest
from typer.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parent.parent / "tactile"))
from raw_folder import write_raw

from pipeline.batch import open_batch
from pipeline.cli import app
from pipeline.diary import Diary
from pipeline.grade import _kept
from pipeline.grasped import grasped_fruit
from pipeline.layout import Results
from pipeline.records import FruitRecord, Given, ModulusRecord, write_record
from pipeline.task import fruit_task
from pipeline.whose import Owner, owner_findings
from tactile.failure import TactileFailure, TactileProblem

DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"


def relabel(path, **attributes):
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)


def differ(path, times):
    with h5py.File(path, "r+") as file:
        for pad in ("left", "right"):
            file[f"pads/{pad}/force_N"][...] *= times


@pytest.fixture
def batch(tmp_path):
    """Two fruit with a recording each that names its own."""
    for k, name in enumerate(("N02", "N04")):
        folder = tmp_path / "fruits" / name
        (folder / "grasps").mkdir(parents=True)
        for file in ("fruit.ply", "pit.ply"):
            shutil.copyfile(DATA / file, folder / file)
        shutil.copyfile(DATA / "grasp.h5", folder / "grasps" / "grasp-1.h5")
        relabel(folder / "grasps" / "grasp-1.h5", fruit_id=name)
        differ(folder / "grasps" / "grasp-1.h5", 1.0 + 0.002 * k)
    (tmp_path / "batch.toml").write_text(
        'category = "nectarine"\npoisson_ratio = 0.45\n[mesh]\nedge_mm = 8.0\npad_edge_mm = 3.0\n'
    )
    (tmp_path / "fruits.csv").write_text("fruit_id\nN02\nN04\n")
    return tmp_path


def recording(batch, fruit="N02"):
    return batch / "fruits" / fruit / "grasps" / "grasp-1.h5"


def checked(batch):
    ran = CliRunner().invoke(app, ["check", str(batch)])
    return ran.exit_code, ran.stdout.replace(f"{batch}/", "")


def prepared(batch, fruit="N02"):
    """The fruit up to its elements, and the diary."""
    diary = Diary(lambda stage: None)
    task = fruit_task(open_batch(batch), fruit, Results(batch / "results"))
    task.results.claim()
    return grasped_fruit(task, diary), diary


REFUSED = (
    'attribute fruit_id: found "N04", expected "N02": it is the recording of another fruit of this batch. '
    "Move the file to fruits/N04/grasps, or correct the attribute fruit_id if it is of N02."
)
DOUBTED = 'attribute fruit_id: found "N77", expected "N02", and fruits.csv has no "N77"'


def test_check_refuses_the_recording_of_another_fruit_of_the_batch(batch):
    relabel(recording(batch), fruit_id="N04")
    status, text = checked(batch)
    assert status == 2
    assert f"fruits/N02/grasps/grasp-1.h5: grasp-1.h5: {REFUSED}" in text


def test_grading_refuses_it_too(batch):
    relabel(recording(batch), fruit_id="N04")
    with pytest.raises(TactileFailure) as refused:
        prepared(batch)
    assert refused.value.problem is TactileProblem.FOREIGN_RECORDING
    assert refused.value.detail == f"grasp-1: {REFUSED}"


def test_a_refused_one_costs_no_other_recording(batch):
    shutil.copyfile(recording(batch, "N04"), recording(batch).with_name("grasp-2.h5"))
    fruit, diary = prepared(batch)
    assert [grasp.name for grasp in fruit.placed] == ["grasp-1"]
    assert diary.known["strangers"] == {"N04": True}
    assert fruit.doubts == ()
    assert any(said.startswith("not used: grasp-2: attribute fruit_id") for said in diary.warnings)


def test_an_id_that_the_batch_does_not_have_puts_E_in_doubt(batch):
    relabel(recording(batch), fruit_id="N77")
    status, text = checked(batch)
    assert status == 4
    assert DOUBTED in text
    fruit, diary = prepared(batch)
    (doubt,) = fruit.doubts
    assert DOUBTED in doubt.sentence
    assert doubt.relative_sd == pytest.approx(0.35)
    assert diary.warnings[0] == doubt.sentence


@pytest.mark.parametrize("said", ["", "N02", " n02", "unknown"])
def test_a_recording_that_names_its_own_fruit_or_none_is_not_doubted(batch, said):
    relabel(recording(batch), fruit_id=said)
    assert checked(batch)[0] == 0
    assert prepared(batch)[0].doubts == ()


def test_another_known_category_puts_E_in_doubt_and_one_of_the_users_own_does_not(batch):
    relabel(recording(batch), category="plum")
    status, text = checked(batch)
    assert status == 4
    assert 'category: found "plum", expected "nectarine" as in batch.toml' in text
    assert ["plum" in one.sentence for one in prepared(batch)[0].doubts] == [True]
    relabel(recording(batch), category="our early nectarine")
    assert checked(batch)[0] == 0
    fruit, diary = prepared(batch)
    assert fruit.doubts == ()
    assert any('its category is "our early nectarine"' in one for one in diary.warnings)


def test_a_case_of_its_own_may_be_called_otherwise():
    assert (
        owner_findings("N77", "plum", Owner(fruit_id="case-1"), source="g", field="attribute fruit_id") == []
    )


def test_a_kept_record_holds_only_while_the_batch_has_the_same_strangers(batch):
    task = fruit_task(open_batch(batch), "N02", Results(batch / "results"))
    task.results.claim()
    (batch / "results" / "fruits" / "N02" / "fruit.ply").write_text("made")
    record = FruitRecord(
        fruit_id="N02", outcome="graded", key=task.key, given=Given(), strangers={"N77": False},
        modulus=ModulusRecord(E_MPa=0.5, E_sd_MPa=0.1),
    )  # fmt: skip
    write_record(task.results.record, record)
    assert dict(_kept({"N02": task})) == {"N02": record}
    assert dict(_kept({"N02": task, "N77": task})) == {}


def test_explain_says_it_of_a_batchs_fruit(batch):
    relabel(recording(batch), fruit_id="N04")
    ran = CliRunner().invoke(app, ["explain", str(batch), "--fruit", "N02"])
    assert ran.exit_code == 3
    assert REFUSED in " ".join(ran.output.split())


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

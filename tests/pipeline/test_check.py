"""`drupe check` says of every file what stands in its way, and what grading will put in doubt."""

import shutil
from pathlib import Path

import h5py
import pytest

from pipeline import check as checking
from pipeline.check import check
from tactile.recording import read_recording

DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"


@pytest.fixture
def batch(tmp_path):
    """Two fruit, the same nectarine with its recording each."""
    for name in ("A", "B"):
        folder = tmp_path / "fruits" / name
        (folder / "grasps").mkdir(parents=True)
        shutil.copyfile(DATA / "fruit.ply", folder / "fruit.ply")
        shutil.copyfile(DATA / "grasp.h5", folder / "grasps" / "grasp-1.h5")
    (tmp_path / "batch.toml").write_text('category = "nectarine"\n')
    (tmp_path / "fruits.csv").write_text("fruit_id\nA\nB\n")
    return tmp_path


def said(batch):
    return [str(one).replace(f"{batch}/", "") for one in check(batch)]


def on_one_line(path):
    with h5py.File(path, "r+") as file:
        file["pads/left/rest_mm"][:, 1] = 0.0


def test_a_sound_batch_has_no_problem(batch):
    assert said(batch) == []


def test_markers_on_a_line_are_said_and_hide_no_other_problem(batch):
    on_one_line(batch / "fruits" / "A" / "grasps" / "grasp-1.h5")
    (batch / "fruits" / "B" / "fruit.ply").write_bytes(b"no mesh")
    first, second = said(batch)
    assert first.startswith("fruits/A/grasps/grasp-1.h5: grasp-1.h5: pads/left/rest_mm: found")
    assert "on one line" in first
    assert second.startswith("fruits/B/fruit.ply")


@pytest.mark.parametrize("fault", [ValueError("QH6013\n  of the library"), KeyError("x"), RuntimeError()])
def test_a_fault_of_drupe_itself_is_one_line_of_the_file_and_hides_no_other(batch, monkeypatch, fault):
    def faulty(path, **options):
        if path.parts[-3] == "A":
            raise fault
        return read_recording(path, **options)

    monkeypatch.setattr(checking, "read_recording", faulty)
    (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_bytes(b"nothing")
    first, second = said(batch)
    beginning = "fruits/A/grasps/grasp-1.h5: a fault of drupe itself reading grasp-1.h5: "
    assert first.startswith(beginning + type(fault).__name__)
    assert "\n" not in first
    assert "of the library" not in first
    assert second.startswith("fruits/B/grasps/grasp-1.h5")

"""`drupe check` says of every file what stands in its way, and what grading will put in doubt."""

import shutil
from pathlib import Path

import h5py
import pytest

from pipeline import check as checking
from pipeline.batch import open_batch
from pipeline.check import check, implausible_fruit
from recon.mesh_file import read_mesh, write_mesh
from recon.pit import place_pit
from recon.priors import load_prior
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


def test_each_mesh_is_read_once(batch, monkeypatch):
    opened = []

    def counted(path):
        opened.append(path.relative_to(batch / "fruits").as_posix())
        return read_mesh(path)

    monkeypatch.setattr(checking, "read_mesh", counted)
    vertices, faces = place_pit(*read_mesh(DATA / "fruit.ply"), load_prior("nectarine"))
    write_mesh(batch / "fruits" / "B" / "pit.ply", vertices, faces)
    assert said(batch) == []
    assert sorted(opened) == ["A/fruit.ply", "B/fruit.ply", "B/pit.ply"]


def test_grade_ends_by_the_rules_that_check_says(batch):
    """One slip in the table, one in a mesh: the sentences are the same."""
    (batch / "fruits.csv").write_text("fruit_id,mass_g\nA,0.1\nB,\n")
    vertices, faces = read_mesh(DATA / "fruit.ply")
    write_mesh(batch / "fruits" / "B" / "fruit.ply", 0.001 * vertices, faces)
    ended = implausible_fruit(open_batch(batch))
    assert set(ended) == {"A", "B"}
    checked = [one.sentence.removeprefix("A: ") for one in check(batch) if one.implausible]
    assert checked == [ended["A"], ended["B"]]

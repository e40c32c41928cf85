"""Which files of a fruit's folder count, and which are not used."""

import io
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rich.console import Console
from small_batches import empty_batch

from pipeline.batch.layout import (
    BatchFolder,
    CaseFolder,
    FruitFolder,
    FruitResults,
    Results,
    is_of_the_system,
    write_whole,
)
from pipeline.batch.opening import open_batch
from pipeline.batch.provenance import input_hashes
from pipeline.batch.task import fruit_task
from pipeline.batch.unused_files import unused_of_batch, unused_of_fruit
from pipeline.files.manifest import LIST_LOCK, MANIFEST
from pipeline.files.whole_file import put
from pipeline.fruit.stages import grade_fruit
from pipeline.run.checking import check
from pipeline.run.grading import say_begun


def test_hidden_files_and_folders_are_neither_photos_nor_recordings(tmp_path):
    for name in ("photos/1.jpg", "photos/._1.jpg", "grasps/a.h5", "grasps/.a.h5"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "photos" / "2.jpg").mkdir()
    (tmp_path / "grasps" / "b.h5").mkdir()
    folder = FruitFolder(tmp_path)
    assert [p.name for p in folder.photo_files()] == ["1.jpg"]
    assert [p.name for p in folder.grasp_files()] == ["a.h5"]


def test_a_ready_mesh_makes_photos_no_input(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.jpg").touch()
    (tmp_path / "fruit.ply").touch()
    assert [p.name for p in FruitFolder(tmp_path).input_files()] == ["fruit.ply"]


def test_a_failed_write_leaves_the_old_file_and_no_scrap(tmp_path):
    path = tmp_path / "file"
    write_whole(path, "old")
    path_is_folder = tmp_path / "folder"
    path_is_folder.mkdir()
    (path_is_folder / "x").touch()
    with pytest.raises(OSError, match="folder"):
        write_whole(path_is_folder, "new")
    assert path.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_forgetting_keeps_what_the_stages_made(tmp_path):
    results = FruitResults(tmp_path)
    results.claim()
    for path in (results.record, results.picture):
        write_whole(path, "x")
    put(results.cache / "mesh.npz", b"x")
    results.forget()
    left = {p.name for p in tmp_path.rglob("*") if p.is_file()} - {MANIFEST, LIST_LOCK}
    assert left == {"mesh.npz"}


def test_recordings_come_in_the_order_in_which_they_are_counted(tmp_path):
    (tmp_path / "grasps").mkdir()
    for name in ("grasp-10", "grasp-2", "grasp-1", "b", "a", "grasp-2b"):
        (tmp_path / "grasps" / f"{name}.h5").touch()
    stems = [path.stem for path in FruitFolder(tmp_path).grasp_files()]
    assert stems == ["a", "b", "grasp-1", "grasp-2", "grasp-2b", "grasp-10"]


def test_photos_of_the_fruit_upside_down_are_inputs_and_are_checked(tmp_path):
    """Every file is read, and three at least must be there."""
    batch = tmp_path / "batch"
    fruit = batch / "fruits" / "N01"
    empty_batch(batch, "N01", table="fruit_id,height_mm\nN01,56\n")
    for name in ("photos", "photos-flipped"):
        (fruit / name).mkdir()
    picture = cv2.imencode(".jpg", np.full((30, 40, 3), 90, np.uint8))[1].tobytes()
    for name in ("photos/1.jpg", "photos/2.jpg", "photos/3.jpg", "photos-flipped/1.jpg"):
        (fruit / name).write_bytes(picture)
    (fruit / "photos-flipped" / "2.jpg").write_bytes(b"")
    files = [p.relative_to(fruit).as_posix() for p in FruitFolder(fruit).input_files()]
    assert files[-2:] == ["photos-flipped/1.jpg", "photos-flipped/2.jpg"]
    said = [p.sentence for p in check(batch) if "flipped" in p.file]
    assert any("upside-down fruit holds 2 photos" in sentence for sentence in said)
    assert any("2.jpg in" in sentence and "is empty" in sentence for sentence in said)


def test_inputs_have_the_same_names_however_the_batch_is_named(tmp_path, monkeypatch):
    grasp = tmp_path / "batch" / "fruits" / "N01" / "grasps" / "g"
    grasp.mkdir(parents=True)
    (grasp / "grasp.toml").write_text(
        'sensor = "sensor.toml"\n[pads.left]\nsensor = "other.toml"\n[pads.right]\nsensor = "pipe.toml"\n'
    )
    (tmp_path / "batch" / "sensor.toml").touch()
    os.mkfifo(tmp_path / "batch" / "pipe.toml")
    (tmp_path / "link").symlink_to(tmp_path / "batch")
    monkeypatch.chdir(tmp_path)
    names = {"fruits/N01/grasps/g/grasp.toml", "sensor.toml"}
    for root in (tmp_path / "batch", Path("batch"), Path("link")):
        assert set(input_hashes(root, BatchFolder(root).fruit("N01").input_files())) == names
    grasp.symlink_to(grasp.rename(tmp_path / "elsewhere"))
    (tmp_path / "other.toml").touch()
    hashed_names = set(input_hashes(Path("batch"), BatchFolder(Path("batch")).fruit("N01").input_files()))
    assert hashed_names >= {"fruits/N01/grasps/g/grasp.toml", str(tmp_path / "other.toml")}


SAID = "scan.stl is not used: drupe reads one mesh named fruit"


@pytest.fixture
def batch(tmp_path):
    """A batch of one fruit whose mesh is none, so that grading it ends at once."""
    root = empty_batch(tmp_path / "batch", "A", table="fruit_id,height_mm\nA,55.9\n")
    (root / "fruits" / "A" / "fruit.ply").write_bytes(b"no mesh")
    return root


def _task(root: Path):
    return fruit_task(open_batch(root), "A", Results(root / "results"))


def test_a_file_that_is_not_used_is_a_warning_of_the_fruits_record_and_makes_it_graded_anew(batch):
    before = _task(batch)
    (batch / "fruits" / "A" / "notes.txt").touch()
    assert _task(batch).key == before.key
    (batch / "fruits" / "A" / "scan.stl").touch()
    after = _task(batch)
    assert after.key != before.key
    record = grade_fruit(replace(after, screen=False), lambda _: None)
    assert any(SAID in warning for warning in record.warnings)
    assert record.outcome == "unreadable-mesh"


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (os.mkfifo, "it is a named pipe, not a file"),
        (lambda path: path.symlink_to("/nowhere/grasp.h5"), "it is a link to nothing"),
        (lambda path: path.symlink_to("/dev/zero"), "it is a device, not a file"),
    ],
)
def test_what_has_a_recordings_name_and_is_no_file_is_said(batch, make, said):
    make(batch / "fruits" / "A" / "grasps" / "grasp-1.h5")
    (unused,) = unused_of_fruit(FruitFolder(batch / "fruits" / "A"))
    assert unused.sentence.startswith(f"grasp-1.h5 is not used: {said}")


def test_grading_prints_what_is_not_used_and_not_more_than_can_be_read(batch, monkeypatch):
    monkeypatch.setattr("pipeline.run.grading.MOST_UNUSED_SAID", 2)
    for k in range(30):
        (batch / "fruits" / f"_{k}").mkdir()
    (batch / "fruits" / "A" / "scan.stl").touch()  # told with its fruit
    for name in ("grasp-2.h5", "list.csv", "raw.zip"):
        (batch / name).touch()
    out = io.StringIO()
    run, console = SimpleNamespace(batch=open_batch(batch)), Console(file=out, width=80)
    say_begun(SimpleNamespace(kept=[], run=run, console=console))
    first, second, last = out.getvalue().splitlines()
    assert first.startswith("warning: grasp-2.h5: grasp-2.h5 is not used: drupe reads recordings in")
    assert second.startswith("warning: list.csv: list.csv is not used: fruits.csv lists the fruit")
    assert last == "warning: and 2 more: `drupe check` lists all"
    assert "scan.stl" not in out.getvalue()


def test_every_kind_of_stray_file_has_its_own_advice(tmp_path):
    (tmp_path / "grasps").mkdir()
    for name in ("a.zip", "b.mp4", "c.pcd", "d.heic", "e.npz", "f.step", "grasps/h.zip", "grasps/i.jpg"):
        (tmp_path / name).touch()
    (tmp_path / "fruit.ply").touch()
    said = " ".join(unused.sentence for unused in unused_of_fruit(FruitFolder(tmp_path)))
    for words in (
        "a.zip is not used: drupe does not open archives",
        "b.mp4 is not used: drupe reads a video",
        "c.pcd, f.step are not used: meshes are read as",
        "d.heic is not used: drupe reads photos in",
        "e.npz is not used: fruits.csv lists",
        "h.zip is not used",
        "i.jpg is not used: drupe reads photos in",
    ):
        assert words in said


def test_what_settings_and_raw_grasps_name_is_used(tmp_path):
    raw = tmp_path / "fruits" / "A" / "grasps" / "raw"
    raw.mkdir(parents=True)
    (raw / "grasp.toml").write_text('[pads.left]\nframes = "../../../../left.avi"\n')
    for name in ("left.avi", "pit.stl", "right.avi"):
        (tmp_path / name).touch()
    unused = unused_of_batch(BatchFolder(tmp_path), {tmp_path / "pit.stl"})
    said = [Path(problem.file).name for problem in unused]
    assert said == ["right.avi"]


def test_the_exact_name_comes_before_others_and_ply_before_stl(tmp_path):
    for name in ("Fruit.PLY", "fruit.stl", "FRUIT.obj"):
        (tmp_path / name).touch()
    folder = FruitFolder(tmp_path)
    assert folder.fruit_ply.name == "Fruit.PLY"
    assert [Path(unused.file).name for unused in unused_of_fruit(folder)] == ["FRUIT.obj"]
    (tmp_path / "fruit.ply").touch()
    assert folder.fruit_ply.name == "fruit.ply"
    (said,) = unused_of_fruit(folder)
    assert said.sentence.startswith(
        "FRUIT.obj, Fruit.PLY, fruit.stl are not used: drupe reads one mesh named fruit"
    )


def test_recordings_of_one_stem_keep_apart(tmp_path):
    for name in ("g.h5", "g.HDF5", "h.mat", "._g.h5"):
        (tmp_path / name).touch()
    assert sorted(CaseFolder(tmp_path).recordings_by_name()) == ["g.HDF5", "g.h5", "h"]


@pytest.mark.parametrize(
    "name", ["@eaDir", "$RECYCLE.BIN", "#recycle", "System Volume Information", "lost+found"]
)
def test_folders_of_systems_are_no_fruit_and_no_grasp(tmp_path, name):
    assert is_of_the_system(name)
    (tmp_path / "grasps" / name).mkdir(parents=True)
    assert FruitFolder(tmp_path).raw_grasp_folders() == ()


@pytest.mark.parametrize(
    ("names", "without"),
    [
        ((), False),
        (("a.mat",), False),
        (("a.mat", "plates.hdf5"), True),
        (("plates.h5",), True),
        (("plates.h5", "a.mat"), True),
        (("plates.h5", "a.mat", "gel.H5"), False),
    ],
)
def test_only_plates_are_taken_for_the_shape(tmp_path, monkeypatch, names, without):
    monkeypatch.setattr("pipeline.batch.layout.is_of_bare_indenter", lambda path: path.stem == "plates")
    (tmp_path / "grasps").mkdir()
    for name in names:
        (tmp_path / "grasps" / name).touch()
    assert FruitFolder(tmp_path).without_shape() is without

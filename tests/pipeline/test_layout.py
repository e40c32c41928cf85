"""Which files of a fruit's folder count."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_batches import empty_batch

from pipeline.batch.layout import BatchFolder, FruitFolder, FruitResults, write_whole
from pipeline.batch.provenance import input_hashes
from pipeline.files.manifest import LIST_LOCK, MANIFEST
from pipeline.files.whole_file import put
from pipeline.run.checking import check


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
    moved = grasp.rename(tmp_path / "elsewhere")
    grasp.symlink_to(moved)
    (tmp_path / "other.toml").touch()
    hashed_names = set(input_hashes(Path("batch"), BatchFolder(Path("batch")).fruit("N01").input_files()))
    assert hashed_names >= {"fruits/N01/grasps/g/grasp.toml", str(tmp_path / "other.toml")}

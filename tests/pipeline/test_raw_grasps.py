"""Raw grasps and their references in a batch: which folders count, what is read once, what is said."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_gel import drawn, grid
from raw_folder import CENTRE, FRAMES, replaced, write_picture, write_raw
from refusals import refused
from small_batches import DATA

from pipeline.batch.layout import FruitFolder, raw_grasp_files
from pipeline.fruit import grasped
from pipeline.fruit.grasped import kept_recording
from pipeline.fruit.placed_grasp import Checked, place_grasp
from pipeline.recordings.conversion import ConvertRequest, convert
from pipeline.run.checking import check
from recon.surface.mesh_file import read_mesh
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import Converted, read_recording
from tactile.tactile_failure import TactileFailure, TactileProblem

RECORDING = Path(__file__).parents[1] / "data" / "nectarine-grasp" / "grasp.h5"


@pytest.fixture
def folder(tmp_path):
    raw = tmp_path / "fruits" / "N01" / "grasps" / "grasp-1"
    (raw / "left").mkdir(parents=True)
    (raw / "grasp.toml").write_text('fruit_id = "N01"\nsensor = "sensor.toml"\n')
    (raw / "left" / "frame_000000.png").write_bytes(b"one")
    (tmp_path / "sensor.toml").write_text('kind = "markers-mono"\n')
    (tmp_path / "batch.toml").write_text('category = "plum"\n')
    return raw


@pytest.fixture
def readings(monkeypatch):
    """Every reading of frames, which gives the same recording each time."""
    seen: list[Path] = []
    monkeypatch.setattr(grasped, "read_raw_grasp", lambda path: seen.append(path) or path)
    monkeypatch.setattr(
        grasped,
        "recording_of",
        lambda raw, progress: Converted(recording=read_recording(RECORDING), notes=("one frame twice",)),
    )
    return seen


def test_frames_are_read_once_and_again_when_one_of_them_changes(folder, readings, tmp_path):
    first = kept_recording(folder, tmp_path / "cache", print)
    again = kept_recording(folder, tmp_path / "cache", print)
    assert (first, len(readings)) == (again, 1)
    path, notes = first
    assert notes == ("one frame twice",)
    np.testing.assert_array_equal(read_recording(path).time_s, read_recording(RECORDING).time_s)
    (folder / "left" / "frame_000000.png").write_bytes(b"two")
    kept_recording(folder, tmp_path / "cache", print)
    assert len(readings) == 2


def test_the_sensors_description_above_counts_and_the_batchs_settings_do_not(folder, readings, tmp_path):
    kept_recording(folder, tmp_path / "cache", print)
    (tmp_path / "batch.toml").write_text('category = "peach"\n')
    kept_recording(folder, tmp_path / "cache", print)
    assert len(readings) == 1
    (tmp_path / "sensor.toml").write_text('kind = "markers-stereo"\n')
    kept_recording(folder, tmp_path / "cache", print)
    assert len(readings) == 2


def test_what_a_raw_grasp_does_not_name_is_none_of_its_files(folder, readings, tmp_path):
    kept_recording(folder, tmp_path / "cache", print)
    for place in (folder.parent, folder.parents[1], folder.parents[2], tmp_path):
        (place / "notes.toml").write_text("a = 1\n")
        (place / "other.npz").write_bytes(b"other")
    kept_recording(folder, tmp_path / "cache", print)
    assert len(readings) == 1


def test_frames_that_lie_elsewhere_are_files_of_the_grasp_that_names_them(folder, tmp_path):
    (tmp_path / "sensor.toml").write_text('kind = "markers-mono"\n')
    elsewhere = tmp_path / "disk"
    elsewhere.mkdir()
    for name in ("frame_000000.png", "reference.png", "notes.txt"):
        (elsewhere / name).write_bytes(b"one")
    (folder / "right").symlink_to(elsewhere)
    (folder / "grasp.toml").write_text(
        'sensor = "sensor.toml"\n[pads.left]\nframes = "../../../../disk"\n[pads.right]\n'
    )
    names = [path.name for path in raw_grasp_files(folder)]
    assert sorted(names) == sorted(
        ["grasp.toml", "frame_000000.png", "sensor.toml"] + 2 * ["frame_000000.png", "reference.png"]
    )


def test_a_name_longer_than_any_file_has_is_refused(folder):
    for table in ('sensor = "{}"', 'sensor = "sensor.toml"\n[pads.left]\nframes = "{}"'):
        (folder / "grasp.toml").write_text(table.format("x" * 300))
        assert folder / "grasp.toml" in raw_grasp_files(folder)
    (folder / "grasp.toml").write_text(
        'fruit_id = "N01"\ncategory = "plum"\nloading = "grasp"\npose_aperture_mm = 60.0\n[pads.left]\n'
        f'sensor = "{"x" * 300}"\n[pads.right]\n'
    )
    (folder / "log.csv").write_text("time_s,aperture_mm\n0,60\n")
    with pytest.raises(TactileFailure, match="a file's name of at most 255 bytes"):
        read_raw_grasp(folder)


def test_another_grasps_kept_recording_stays(folder, readings, tmp_path):
    other = folder.with_name("grasp")
    (other / "left").mkdir(parents=True)
    path, _ = kept_recording(folder, tmp_path / "cache", print)
    kept_recording(other, tmp_path / "cache", print)
    assert path.is_file()


def test_frames_that_cannot_be_read_leave_nothing_behind(folder, monkeypatch, tmp_path):
    def refused(path):
        raise TactileFailure(TactileProblem.UNREADABLE_FRAMES, "left: found no frames")

    monkeypatch.setattr(grasped, "read_raw_grasp", refused)
    with pytest.raises(TactileFailure, match="found no frames"):
        kept_recording(folder, tmp_path / "cache", print)
    assert not list((tmp_path / "cache").glob("*"))


def test_a_folder_counts_as_a_grasp_until_a_recording_of_its_name_stands_for_it(folder):
    fruit = FruitFolder(folder.parents[1])
    (folder.parent / ".hidden").mkdir()
    assert [path.name for path in fruit.raw_grasp_folders()] == ["grasp-1"]
    assert folder / "left" / "frame_000000.png" in fruit.input_files()
    (folder.parent / "grasp-1.h5").touch()
    assert fruit.raw_grasp_folders() == ()
    assert [path.name for path in fruit.grasp_files()] == ["grasp-1.h5"]


def test_a_kept_recording_with_a_flipped_bit_is_made_again(folder, readings, tmp_path):
    path, notes = kept_recording(folder, tmp_path / "cache", print)
    recording, kept = path.read_bytes(), path.with_suffix(".npz")
    for file in (kept, path):
        sound = file.read_bytes()
        for bit in np.random.default_rng(7).integers(0, 8 * len(sound), 24):
            spoilt = bytearray(sound)
            spoilt[bit // 8] ^= 1 << (bit % 8)
            file.write_bytes(spoilt)
            assert kept_recording(folder, tmp_path / "cache", print) == (path, notes)
            assert path.read_bytes() == recording
    assert len(readings) > 20


ADVICE = "reference = ... in grasp.toml"


def bulged(px):
    """A gel into which a ball is pressed in the middle."""
    away = grid() - CENTRE
    places = grid() + px * away / 50.0 * np.exp(0.5 - (away**2).sum(axis=1, keepdims=True) / 2 / 50.0**2)
    return drawn(places, noise=1.0)


@pytest.fixture
def batch(tmp_path):
    """One fruit with one raw grasp, and beside the fruit a clip of the empty gel."""
    folder = tmp_path / "fruits" / "f1"
    write_raw(folder / "grasps" / "grasp-1")
    shutil.copyfile(DATA / "fruit.ply", folder / "fruit.ply")
    write_picture(tmp_path / "empty" / "frame_000000.png", drawn(grid(), noise=1.0))
    (tmp_path / "batch.toml").write_text('category = "nectarine"\n')
    (tmp_path / "fruits.csv").write_text("fruit_id\nf1\n")
    return tmp_path


def raw_of(batch):
    return batch / "fruits" / "f1" / "grasps" / "grasp-1"


def print_on_the_reference(batch):
    write_picture(raw_of(batch) / "left" / "reference.png", bulged(5.0))


def about_references(batch):
    return [str(problem) for problem in check(batch) if "reference" in str(problem)]


def test_check_is_silent_on_empty_references(batch):
    assert about_references(batch) == []


def test_check_says_that_a_reference_bears_a_print_and_a_clip_of_the_empty_gel_mends_it(batch):
    print_on_the_reference(batch)
    (said,) = about_references(batch)
    assert "grasp-1/left: the reference shows a contact imprint: its markers bulge" in said
    assert ADVICE in said
    new = 'sensor = "left.toml"\nreference = "../../../../empty"'
    replaced(raw_of(batch) / "grasp.toml", 'sensor = "left.toml"', new)
    assert about_references(batch) == []


def test_convert_says_it_in_its_notes_and_not_that_the_jaws_should_close_further(batch, tmp_path):
    """The left gel is loaded in its reference alone."""
    print_on_the_reference(batch)
    for t in range(FRAMES):
        write_picture(raw_of(batch) / "left" / f"frame_{t:06d}.png", drawn(grid(), noise=1.0, seed=t))
    lines: list[str] = []
    notes = convert(raw_of(batch), tmp_path / "out.h5", ConvertRequest(), report=lines.append).notes
    assert any("the reference shows a contact imprint" in note and ADVICE in note for note in notes)
    assert not any("close the jaws" in line for line in lines)
    assert any(
        "the left pad's" in line and "the reference shows a contact imprint itself" in line for line in lines
    )


def test_grade_refuses_the_recording_for_its_reference(batch, tmp_path):
    print_on_the_reference(batch)
    path, notes = kept_recording(raw_of(batch), tmp_path / "cache", lambda line: None)
    assert any("the reference shows a contact imprint" in note for note in notes)
    mesh = read_mesh(DATA / "fruit.ply")
    with refused(TactileProblem.IMPLAUSIBLE_RECORDING, "reference shows a contact imprint"):
        place_grasp(path, *mesh, name="grasp-1", checked=Checked())


def test_the_named_clip_is_in_the_key_of_what_is_kept(batch, tmp_path, monkeypatch):
    """Whatever is made of the pictures."""
    made = SimpleNamespace(recording=read_recording(DATA / "grasp.h5"), notes=())
    calls = []
    monkeypatch.setattr(grasped, "recording_of", lambda *_, **__: calls.append(1) or made)
    new = 'sensor = "left.toml"\nreference = "../../../../empty"'
    replaced(raw_of(batch) / "grasp.toml", 'sensor = "left.toml"', new)
    kept_recording(raw_of(batch), tmp_path / "cache", lambda line: None)
    write_picture(batch / "empty" / "frame_000000.png", drawn(grid() + 0.5, noise=1.0))
    kept_recording(raw_of(batch), tmp_path / "cache", lambda line: None)
    assert len(calls) == 2

"""`drupe check`, `convert` and `grade` say that a reference shows a contact imprint, and what to do."""

import shutil
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from drawn_gel import drawn, grid
from raw_folder import CENTRE, FRAMES, replaced, write_picture, write_raw
from small_batches import DATA, batch_of_nectarines

from pipeline.fruit import grasped
from pipeline.fruit.grasped import kept_recording
from pipeline.fruit.placed_grasp import Checked, place_grasp
from pipeline.recordings.conversion import ConvertRequest, convert
from pipeline.run.checking import check
from recon.surface.mesh_file import read_mesh
from tactile.readers.recording import read_recording
from tactile.tactile_failure import TactileFailure, TactileProblem

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


def test_check_refuses_a_reference_outside_the_batch(batch):
    new = 'sensor = "left.toml"\nreference = "../../../../../x.png"'
    replaced(raw_of(batch) / "grasp.toml", 'sensor = "left.toml"', new)
    (said,) = about_references(batch)
    assert "pads.left.reference: found ../../../../../x.png, which leads out of the batch" in said


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
    with pytest.raises(TactileFailure, match="reference shows a contact imprint") as caught:
        place_grasp(path, *mesh, name="grasp-1", checked=Checked())
    assert caught.value.problem is TactileProblem.IMPLAUSIBLE_RECORDING


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


def test_check_says_of_a_recording_that_its_pictures_show_a_print_but_no_force(tmp_path):
    batch_of_nectarines(tmp_path, "A")
    with h5py.File(tmp_path / "fruits" / "A" / "grasps" / "grasp-1.h5", "r+") as file:
        frames = len(file["time_s"])
        file["pads/left/force_N"][...] *= 1e-6
        file["pads/left/print_shown"] = np.full(frames, 3.0)
    (said,) = [str(problem) for problem in check(tmp_path)]
    assert (
        "the left pad's pictures show a contact imprint (3.0 times the limit for an empty gel), yet its force"
        in said
    )
    assert "the gel is under load from frame 0 on" in said
    assert "never touches" not in said

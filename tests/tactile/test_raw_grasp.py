"""Where the picture of the untouched gel comes from, what is refused as one, and a jaw that is plain."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from drawn_gel import drawn, grid
from raw_folder import FRAMES, replaced, write_picture, write_raw

from tactile.from_frames import recording_of
from tactile.plain_jaw import has_plain_jaw
from tactile.readers.raw_grasp import files_of, read_raw_grasp
from tactile.readers.recording import GelPad, IndenterPad, read_recording, write_recording
from tactile.tactile_failure import TactileFailure, TactileProblem

LEFT = 'sensor = "left.toml"'


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A grasp in a batch, which also has a clip of the empty left gel; the grasp's own reference is gone."""
    batch = tmp_path_factory.mktemp("made") / "batch"
    folder = write_raw(batch / "fruits" / "f1" / "grasps" / "grasp-1")
    (batch / "batch.toml").write_text("")
    for t in range(4):
        write_picture(batch / "empty" / f"frame_{t:06d}.png", drawn(grid(), light=1.0 + 0.1 * t))
    (folder / "left/reference.png").unlink()
    write_picture(batch.parent / "secret.png", drawn(grid()))
    return batch


@pytest.fixture
def grasp(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole.parent, tmp_path / "made")
    return tmp_path / "made" / "batch" / "fruits" / "f1" / "grasps" / "grasp-1"


def names(grasp: Path, line: str) -> Path:
    replaced(grasp / "grasp.toml", LEFT, f"{LEFT}\n{line}")
    return grasp


@pytest.mark.parametrize(
    ("lines", "light"),
    [
        ('reference = "../../../../empty"', 1.15),
        ('reference = "../../../../empty"\nreference_frames = [3, 4]', 1.3),
        ('reference = "../../../../empty/frame_000002.png"', 1.2),
    ],
)
def test_a_clip_of_the_empty_gel_is_the_reference_by_its_mean(grasp: Path, lines: str, light: float) -> None:
    """Over the mean grey level of the clip's first frame."""
    picture = read_raw_grasp(names(grasp, lines)).pads[0].view.reference
    assert picture.mean() / drawn(grid()).mean() == pytest.approx(light, abs=0.01)


def test_each_pad_has_its_own_reference(grasp: Path) -> None:
    names(grasp, "reference_frames = [0, 2]")
    left, right = read_raw_grasp(grasp).pads
    assert not np.array_equal(left.view.reference, right.view.reference)


REFUSED: list[tuple[str, str, str]] = [
    ("nothing named", "", "or frames of it (reference_frames"),
    ("out of the batch", 'reference = "../../../../../secret.png"',
     "pads.left.reference: found ../../../../../secret.png, which leads out of the batch, expected a file or "
     "folder inside the batch (batch)"),
    ("absolute", 'reference = "/etc/hostname"', "leads out of the batch"),
    ("not there", 'reference = "../../../../full.png"', "found no such file, expected a picture of the"),
    ("no such clip", 'reference = "../../../../empty.avi"', "empty.avi: found no such folder or video"),
    ("picture and frames", 'reference = "../../../../empty/frame_000002.png"\nreference_frames = [0, 1]',
     "beside reference_frames, expected a clip"),
    ("frames past the clip", 'reference = "../../../../empty"\nreference_frames = [2, 5]',
     "pads.left.reference_frames: found [2, 5] of 4 frames"),
    ("no frames", f"reference_frames = [{FRAMES}, {FRAMES}]", "found [8, 8] of 8 frames"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "says"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED])
def test_what_is_no_reference_is_refused_by_file_and_field(grasp: Path, line: str, says: str) -> None:
    with pytest.raises(TactileFailure) as caught:
        read_raw_grasp(names(grasp, line))
    assert says in str(caught.value)
    assert caught.value.problem is TactileProblem.UNREADABLE_FRAMES


def test_a_link_out_of_the_batch_is_not_followed(grasp: Path) -> None:
    (grasp / "left" / "reference-far.png").symlink_to(grasp.parents[4] / "secret.png")
    with pytest.raises(TactileFailure, match="leads out of the batch"):
        read_raw_grasp(names(grasp, 'reference = "left/reference-far.png"'))


def test_the_files_of_a_grasp_hold_the_clip_that_it_names_and_nothing_outside_the_batch(grasp: Path) -> None:
    clip = grasp.parents[3] / "empty"
    assert not any(path.parent.name == "empty" for path in files_of(grasp))
    held = {path.resolve() for path in files_of(names(grasp, 'reference = "../../../../empty"'))}
    assert {path.resolve() for path in clip.iterdir()} <= held
    replaced(grasp / "grasp.toml", "../../../../empty", "../../../../../secret.png")
    assert not any(path.name == "secret.png" for path in files_of(grasp))


PLAIN = """[pads.right]
plain = true
pose = [[0, 0, -1, 30], [1, 0, 0, 0], [0, -1, 0, 40], [0, 0, 0, 1]]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = write_raw(tmp_path_factory.mktemp("raw") / "grasp-1")
    text = (made / "grasp.toml").read_text()
    (made / "grasp.toml").write_text(text[: text.index("[pads.right]")] + PLAIN)
    shutil.rmtree(made / "right")
    return made


def test_it_becomes_a_plate_with_the_gels_force(folder: Path, tmp_path: Path) -> None:
    write_recording(tmp_path / "g.h5", recording_of(read_raw_grasp(folder)).recording)
    recording = read_recording(tmp_path / "g.h5")
    left, right = recording.pads
    assert isinstance(left, GelPad)
    assert isinstance(right, IndenterPad)
    assert has_plain_jaw(recording)
    on_fruit = np.einsum("tij,tnj->ti", left.pose[:, :3, :3], left.force_N)
    assert right.force_z_N == pytest.approx(-np.einsum("tj,tj->t", right.pose[:, :3, 2], on_fruit), abs=1e-5)
    closing = np.diff(recording.aperture_mm)
    assert np.diff(right.pose[:, 0, 3]) == pytest.approx(0.5 * closing)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (PLAIN.replace("plain = true", 'plain = "yes"'), "plain: found 'yes', expected true"),
        (PLAIN + 'sensor = "left.toml"\n', "sensor"),
        (PLAIN.replace("30]", "30, 1]"), "pose"),
        (PLAIN.replace("right", "left") + PLAIN, "one jaw with a gel at least"),
    ],
)
def test_what_a_plain_jaw_cannot_be_is_said(folder: Path, tmp_path: Path, lines: str, words: str) -> None:
    copied = Path(shutil.copytree(folder, tmp_path / "grasp-1"))
    text = (copied / "grasp.toml").read_text()
    (copied / "grasp.toml").write_text(text[: text.index(lines.split("\n")[0])] + lines)
    with pytest.raises(TactileFailure, match=words):
        read_raw_grasp(copied)

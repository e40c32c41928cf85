"""A raw grasp whose right jaw is plain."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from raw_folder import write_raw

from tactile.from_frames import recording_of
from tactile.io.raw_grasp import read_raw_grasp
from tactile.io.recording import GelPad, IndenterPad, read_recording, write_recording
from tactile.plain_jaw import has_plain_jaw
from tactile.tactile_failure import TactileFailure

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
    ],
)
def test_what_a_plain_jaw_cannot_be_is_said(folder: Path, tmp_path: Path, lines: str, words: str) -> None:
    own = Path(shutil.copytree(folder, tmp_path / "grasp-1"))
    text = (own / "grasp.toml").read_text()
    (own / "grasp.toml").write_text(text[: text.index("[pads.right]")] + lines)
    with pytest.raises(TactileFailure, match=words):
        read_raw_grasp(own)


def test_two_plain_jaws_are_no_grasp(folder: Path, tmp_path: Path) -> None:
    own = Path(shutil.copytree(folder, tmp_path / "grasp-1"))
    text = (own / "grasp.toml").read_text()
    start = text.index("[pads.left]")
    (own / "grasp.toml").write_text(text[:start] + PLAIN.replace("right", "left") + PLAIN)
    with pytest.raises(TactileFailure, match="one jaw with a gel at least"):
        read_raw_grasp(own)

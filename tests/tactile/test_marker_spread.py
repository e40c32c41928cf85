"""Spreads of single markers go from frames into the recording and back."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from raw_folder import write_raw

from tactile.from_frames import recording_of
from tactile.io.raw_grasp import read_raw_grasp
from tactile.io.recording import GelPad, Recording, read_recording, write_recording
from tactile.tactile_failure import TactileFailure


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_raw(tmp_path_factory.mktemp("raw") / "grasp-1")


@pytest.fixture(scope="module")
def made(folder: Path) -> Recording:
    return recording_of(read_raw_grasp(folder), covariance=True).recording


def gel(recording: Recording) -> GelPad:
    return recording.pads[0]


def test_what_is_known_of_each_marker_is_kept(made: Recording, tmp_path: Path) -> None:
    write_recording(tmp_path / "g.h5", made)
    spread, own = gel(read_recording(tmp_path / "g.h5")).spread, gel(made).spread
    assert spread.displacement_sd_mm.shape == gel(made).displacement_mm.shape
    assert (spread.displacement_sd_mm > 0).all()
    np.testing.assert_allclose(spread.displacement_sd_mm, own.displacement_sd_mm, rtol=1e-6)
    np.testing.assert_allclose(spread.force_sd_N, own.force_sd_N, rtol=1e-6)


def test_the_covariance_is_that_of_the_frame_of_greatest_force(made: Recording) -> None:
    pad = gel(made)
    joint = pad.spread.joint
    assert joint.frame == np.abs(pad.force_N[:, :, 2]).sum(axis=1).argmax()
    np.testing.assert_allclose(joint.values, joint.values.T, atol=1e-9 * np.abs(joint.values).max())
    assert np.linalg.eigvalsh(joint.values).min() > -1e-9 * np.abs(joint.values).max()
    half = len(joint.values) // 2
    stated = pad.spread.displacement_sd_mm[joint.frame].ravel()
    ratio = np.sqrt(np.diag(joint.values)[:half]) / stated
    assert 0.1 < np.median(ratio) < 1.5


def test_without_the_option_there_is_no_covariance(folder: Path) -> None:
    assert gel(recording_of(read_raw_grasp(folder)).recording).spread.joint is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("lone", "force_sd_N"),
        ("negative", r"displacement_sd_mm: found -1.*0 or more"),
        ("frame", r"joint_covariance: found 9999, expected 0 to"),
    ],
)
def test_a_broken_spread_is_refused_by_its_field(
    made: Recording, tmp_path: Path, change: str, words: str
) -> None:
    path = tmp_path / "g.h5"
    write_recording(path, made)
    with h5py.File(path, "r+") as file:
        pad = file[f"pads/{made.pads[0].name}"]
        if change == "lone":
            del pad["force_sd_N"]
        elif change == "negative":
            pad["displacement_sd_mm"][0, 0, 0] = -1.0
        else:
            pad.attrs["covariance_frame"] = 9999
    with pytest.raises(TactileFailure, match=words):
        read_recording(path)

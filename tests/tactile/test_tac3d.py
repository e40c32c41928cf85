"""A Tac3D folder keeps every number, changes only sign and origin, and its oddities are said."""

from pathlib import Path

import numpy as np
import pytest
from tac3d_folder import FRAMES, KN, KT, REST, write_sensor

from tactile.from_tac3d import recording_of_tac3d
from tactile.readers.recording import Converted, GelPad
from tactile.readers.tac3d import Tac3D, read_tac3d, sensor_folders
from tactile.tactile_failure import TactileFailure


def converted(*sensors: Tac3D) -> Converted:
    return recording_of_tac3d(sensors, fruit_id="f1", category="nectarine")


def gel(sensor: Tac3D) -> GelPad:
    return converted(sensor).recording.pads[0]


def test_every_number_is_kept_but_for_the_forces_sign_and_the_origin(tmp_path: Path) -> None:
    sensor = read_tac3d(write_sensor(tmp_path / "AD2"))
    pad = gel(sensor)
    np.testing.assert_array_equal(pad.displacement_mm, sensor.displacement_mm)
    np.testing.assert_array_equal(pad.force_N, -sensor.force_N)
    np.testing.assert_allclose(pad.rest_mm[:, 2] + 11.0 - 0.03 * 0.5, REST[:, 2], atol=1e-9)
    np.testing.assert_allclose(pad.rest_mm - pad.rest_mm[0], REST - REST[0], atol=1e-9)


def test_a_pressed_gel_pushes_the_fruit_and_its_stiffness_is_read_off_the_loaded_markers(
    tmp_path: Path,
) -> None:
    pad = gel(read_tac3d(write_sensor(tmp_path / "AD2")))
    assert pad.force_N[-1, :, 2].sum() > 0
    assert pad.displacement_mm[-1, :, 2].min() < 0
    assert pad.gel_kn_MPa_per_mm == pytest.approx(KN, rel=0.02)
    assert pad.gel_kt_MPa_per_mm == pytest.approx(KT, rel=0.02)


def test_lost_frames_and_the_deadband_are_said(tmp_path: Path) -> None:
    sensor = read_tac3d(write_sensor(tmp_path / "AD2", lost=(20, 21, 30)))
    said = " ".join(converted(sensor).notes)
    assert "AD2: 3 of 40 frames are missing (2 gaps in the index)" in said
    assert "13 frames are exactly zero (a deadband)" in said
    assert "no aperture and no pose" in said


def test_two_clocks_six_seconds_apart_are_brought_together_by_the_forces(tmp_path: Path) -> None:
    left_sensor = read_tac3d(write_sensor(tmp_path / "left", clock_s=100.0))
    right_sensor = read_tac3d(write_sensor(tmp_path / "right", clock_s=106.0, starts_s=0.12))
    joined = converted(left_sensor, right_sensor)
    assert "the time stamps of left and right differ by 6.12 s (two clocks)" in " ".join(joined.notes)
    left, right = (
        np.asarray(pad.force_N).sum(axis=1)[:, 2] for pad in joined.recording.pads if isinstance(pad, GelPad)
    )
    np.testing.assert_allclose(left, right, atol=0.06 * left.max())


def test_sensor_folders_are_found_in_the_folder_above(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_sensor(tmp_path / name)
    assert [p.name for p in sensor_folders(tmp_path)] == ["a", "b"]
    assert [p.name for p in sensor_folders(tmp_path / "b")] == ["b"]


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        (
            "3D_Forces",
            np.zeros((FRAMES, 35, 3)),
            r"AD2/3D_Forces.npy: found shape \(40, 35, 3\), expected shape",
        ),
        ("3D_Positions", np.full((FRAMES, 36, 3), np.nan), "AD2/3D_Positions.npy: found a value in frame 0"),
        ("sendTimestamp", np.zeros(FRAMES), "AD2/sendTimestamp.npy: found 0 s in frame 1 after 0 s"),
        ("index", np.array(["a"] * FRAMES), "AD2/index.npy: found that it holds values of type"),
    ],
)
def test_a_wrong_array_is_named(tmp_path: Path, name: str, values: np.ndarray, says: str) -> None:
    folder = write_sensor(tmp_path / "AD2")
    np.save(folder / f"{name}.npy", values)
    with pytest.raises(TactileFailure, match=says):
        converted(read_tac3d(folder))


def test_a_cut_and_a_missing_array_are_named(tmp_path: Path) -> None:
    folder = write_sensor(tmp_path / "AD2")
    whole = (folder / "3D_Forces.npy").read_bytes()
    (folder / "3D_Forces.npy").write_bytes(whole[:1000])
    with pytest.raises(TactileFailure, match=r"AD2/3D_Forces\.npy: found .*copy it again"):
        read_tac3d(folder)
    (folder / "3D_Forces.npy").unlink()
    with pytest.raises(TactileFailure, match=r"AD2/3D_Forces\.npy: found no such file"):
        read_tac3d(folder)

"""A simulated robot's frames come back within the stated error; tables with a mistake are refused by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from series_springs import bare_press
from simulated_robot import (
    BASE_FROM_MAT,
    FLANGE_FROM_CAMERA,
    LENS,
    NOISE_DEG,
    NOISE_MM,
    NOISE_PX,
    noisy,
    photographs,
    photographs_of_a_carried_mat,
    pose,
)

from tactile.readers.flange_table import FlangeTable, read_flange_table
from tactile.readers.recording import Recording
from tactile.readers.robot_file import Gripper, Robot, read_gripper
from tactile.robot.base_and_mat import BaseAndMat
from tactile.robot.hand_eye import hand_eye
from tactile.robot.pad_poses import with_robot_poses
from tactile.tactile_failure import TactileFailure

DRAWS = 40
"""Simulated calibrations: the share inside a 90 % region then has a standard deviation of 5 %."""
FLANGE_FROM_PAD = pose(20.0, -30.0, 150.0, 90.0, 10.0, 0.0)


def motion(calibration: BaseAndMat) -> np.ndarray:
    """Error of base_from_mat: rotation vector (rad) and shift (mm)."""
    error = np.linalg.inv(calibration.base_from_mat) @ BASE_FROM_MAT
    return np.concatenate([Rotation.from_matrix(error[:3, :3]).as_rotvec(), error[:3, 3]])


def distance(calibration: BaseAndMat) -> float:
    """Squared error in standard deviations: chi-square of 6 where the covariance is right."""
    return float(motion(calibration) @ np.linalg.solve(calibration.covariance, motion(calibration)))


def by_photos(views, *, camera_on_flange: bool = True) -> BaseAndMat:
    return hand_eye(views, LENS, camera_on_flange=camera_on_flange, source="poses.csv")


@pytest.fixture(scope="module")
def draws() -> list[BaseAndMat]:
    return [by_photos(photographs(np.random.default_rng(seed), count=12)[0]) for seed in range(DRAWS)]


def test_without_noise_every_frame_is_exact():
    calibration = by_photos(photographs(np.random.default_rng(0), scale=0.0)[0])
    np.testing.assert_allclose(calibration.base_from_mat, BASE_FROM_MAT, atol=1e-6)
    np.testing.assert_allclose(calibration.other, FLANGE_FROM_CAMERA, atol=1e-6)


def test_the_region_of_90_percent_covers_the_mats_place_in_90_percent_of_draws(draws):
    inside = np.mean([distance(calibration) < chi2.ppf(0.9, 6) for calibration in draws])
    assert 0.8 <= inside <= 0.98


def test_the_noise_of_flange_and_corners_comes_back(draws):
    assert np.median([calibration.flange_sd_mm for calibration in draws]) == pytest.approx(NOISE_MM, rel=0.1)
    assert np.median([calibration.flange_sd_deg for calibration in draws]) == pytest.approx(
        NOISE_DEG, rel=0.1
    )
    assert np.median([calibration.pixel_sd for calibration in draws]) == pytest.approx(NOISE_PX, rel=0.02)


def test_poses_that_were_not_used_are_predicted_a_little_worse_than_those_used(draws):
    heldout = np.median([calibration.heldout_deg for calibration in draws])
    assert 1.0 * NOISE_DEG < heldout < 1.3 * NOISE_DEG


def a_recording(frames: int = 9) -> Recording:
    """A press with a bare tip, whose pose is fixed on the flange."""
    time_s = np.linspace(0, 1, frames)
    return bare_press(time_s, np.zeros(frames), time_s)


def a_robot(calibration: BaseAndMat, pose_sd_mm: float = 0.0) -> Robot:
    gripper = Gripper(pads={"tip": FLANGE_FROM_PAD}, pose_aperture_mm=0.0, pose_sd_mm=pose_sd_mm)
    return Robot(
        gripper=gripper,
        base_from_mat=calibration.base_from_mat,
        covariance=calibration.covariance,
        flange_sd_mm=calibration.flange_sd_mm,
        flange_sd_deg=calibration.flange_sd_deg,
    )


def a_table(poses: np.ndarray, time_s=None, aperture_mm=None) -> FlangeTable:
    rows = tuple(range(2, len(poses) + 2))
    return FlangeTable(base_from_flange=poses, row=rows, time_s=time_s, aperture_mm=aperture_mm, photo=None)


def placed(robot: Robot, table: FlangeTable, recording: Recording | None = None):
    return with_robot_poses(recording or a_recording(), robot, table, source="a.h5", named="flange.csv")


MAT_FROM_PAD = pose(8.0, -25.0, 28.0, 90.0, 0.0, 15.0)


def test_a_pads_place_is_within_its_stated_error_in_as_many_draws_as_it_should(draws):
    flange = BASE_FROM_MAT @ MAT_FROM_PAD @ np.linalg.inv(FLANGE_FROM_PAD)
    z = []
    for seed, calibration in enumerate(draws):
        table = a_table(noisy(flange, np.random.default_rng(1000 + seed))[None])
        recording, (spread,) = placed(a_robot(calibration), table)
        z.append((recording.pads[0].pose[0, :3, 3] - MAT_FROM_PAD[:3, 3]) / spread.sd_mm)
        assert spread.sd_mm < 0.35
    assert 0.84 <= np.mean(np.abs(z) < 1.645) <= 0.96  # of 120
    assert recording.pose_frame == "mat"


def test_the_gripper_drawings_spread_adds(draws):
    flange = BASE_FROM_MAT @ MAT_FROM_PAD @ np.linalg.inv(FLANGE_FROM_PAD)
    without, more = (placed(a_robot(draws[0], sd), a_table(flange[None]))[1][0].sd_mm for sd in (0.0, 0.5))
    assert more == pytest.approx(np.hypot(without, 0.5))


def test_a_camera_at_rest_and_a_carried_mat_cover_the_mats_place():
    draws = 12
    calibrations = [
        by_photos(photographs_of_a_carried_mat(np.random.default_rng(seed), count=12), camera_on_flange=False)
        for seed in range(draws)
    ]
    total = sum(distance(calibration) for calibration in calibrations)
    assert chi2.ppf(0.005, 6 * draws) < total < chi2.ppf(0.995, 6 * draws)


def scaled(factor: float):
    def of(poses: np.ndarray) -> np.ndarray:
        changed = poses.copy()
        changed[:, :3, 3] *= factor
        return changed

    return of


def single_shifted(poses: np.ndarray) -> np.ndarray:
    changed = poses.copy()
    changed[3, 0, 3] += 8.0
    return changed


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (scaled(0.001), "the flange's in the base's frame"),
        (np.linalg.inv, "the flange's in the base's frame"),
        (single_shifted, r"03\.png .* off the other poses"),
        (lambda poses: np.roll(poses, 1, axis=0), "each row names its own photo"),
        (lambda poses: np.broadcast_to(poses[:1], poses.shape), "rotations that differ by .* second axis"),
    ],
)
def test_a_mistake_in_the_poses_of_photos_is_refused_with_what_to_check(mistake, words):
    views, _ = photographs(np.random.default_rng(3))
    wrong = mistake(np.array([view.base_from_flange for view in views]))
    with pytest.raises(TactileFailure, match=words):
        by_photos([replace(view, base_from_flange=at) for view, at in zip(views, wrong, strict=True)])


def test_few_or_similar_poses_are_refused():
    views, _ = photographs(np.random.default_rng(3))
    with pytest.raises(TactileFailure, match="found 7 usable poses, expected at least 8"):
        by_photos(views[:7])
    with pytest.raises(TactileFailure, match=r"expected at least 5\. Tilt the flange"):
        by_photos(photographs(np.random.default_rng(3), tilt_deg=2.0)[0])


def test_a_camera_at_rest_needs_a_photo_of_the_mat_at_its_place_and_one_on_the_flange_none():
    views = photographs_of_a_carried_mat(np.random.default_rng(0))
    with pytest.raises(TactileFailure, match="expected a photo of the mat at its place"):
        by_photos(views[:-1], camera_on_flange=False)
    with pytest.raises(TactileFailure, match="found rows without a pose"):
        by_photos(views)


def exactly() -> Robot:
    robot = Robot(
        gripper=Gripper(pads={"left": np.eye(4), "right": np.eye(4)}, pose_aperture_mm=60.0, pose_sd_mm=0.0),
        base_from_mat=BASE_FROM_MAT, covariance=1e-6 * np.eye(6), flange_sd_mm=0.1, flange_sd_deg=0.05,
    )  # fmt: skip
    left, right = pose(0, -30, 150, -90, 0, 0), pose(0, 30, 150, 90, 0, 0)
    return replace(robot, gripper=replace(robot.gripper, pads={"left": left, "right": right}))


def a_grasp(aperture_mm: np.ndarray) -> Recording:
    press = a_recording(len(aperture_mm))
    pads = tuple(replace(press.pads[0], name=name) for name in ("left", "right"))
    return replace(press, loading="grasp", pads=pads, aperture_mm=aperture_mm)


UPRIGHT = pose(0.0, 0.0, 190.0, 180.0, 0.0, 0.0)
"""mat_from_flange of a flange that points down, 190 mm above the mat: the pads are at z = 40."""


def test_jaws_close_by_half_of_the_aperture_each_while_the_flange_moves():
    rise = np.array([0.0, 10.0])
    flange = BASE_FROM_MAT @ np.array([UPRIGHT, pose(0.0, 0.0, 200.0, 180.0, 0.0, 0.0)])
    aperture = np.linspace(60.0, 50.0, 5)
    recording, _ = placed(exactly(), a_table(flange, time_s=np.array([0.0, 1.0])), a_grasp(aperture))
    left, right = (pad.pose for pad in recording.pads)
    np.testing.assert_allclose(left[:, 1, 3], aperture / 2, atol=1e-9)  # the flange is turned about x
    np.testing.assert_allclose(right[:, 1, 3], -aperture / 2, atol=1e-9)
    np.testing.assert_allclose(left[:, 2, 3], 40 + np.interp(np.linspace(0, 1, 5), [0, 1], rise), atol=1e-9)
    np.testing.assert_allclose(left[:, :3, 2], [[0, -1, 0]] * 5, atol=1e-9)  # towards the right pad


def test_the_tables_aperture_takes_the_place_of_a_missing_one():
    flange = BASE_FROM_MAT @ np.array([UPRIGHT] * 5)
    with pytest.raises(TactileFailure, match=r"add a column aperture_mm to flange\.csv"):
        placed(exactly(), a_table(flange), a_grasp(np.zeros(5)))
    table = a_table(flange, aperture_mm=np.full(5, 54.0))
    recording, _ = placed(exactly(), table, a_grasp(np.zeros(5)))
    assert recording.aperture_mm.tolist() == [54.0] * 5
    np.testing.assert_allclose(recording.pads[0].pose[:, 1, 3], 27.0)
    single = a_table(flange[:1], aperture_mm=np.full(1, 54.0))
    with pytest.raises(TactileFailure, match="found a single aperture, expected one for each frame"):
        placed(exactly(), single, a_grasp(np.full(5, 55.0)))


FORCE_N, AT_MM = np.array([1.0, -2.0, 3.0]), np.array([5.0, -4.0, 40.0])
"""A force on the mat, and where it acts."""


@pytest.mark.parametrize("frame", ["flange", "base"])
def test_the_load_cells_wrench_is_turned_into_the_mats_frame(frame: str):
    """A force at a known place: what a cell reads in its own frame gives back force and moment on the mat."""
    robot = exactly()
    base_from_flange = BASE_FROM_MAT @ UPRIGHT @ pose(0, 0, 0, 3, -8, 25)
    cell_from_mat = np.linalg.inv(base_from_flange if frame == "flange" else np.eye(4)) @ BASE_FROM_MAT
    force, at = cell_from_mat[:3, :3] @ FORCE_N, cell_from_mat[:3, :3] @ AT_MM + cell_from_mat[:3, 3]
    grasp = replace(a_grasp(np.full(5, 55.0)), wrench_N=np.tile(np.r_[force, np.cross(at, force)], (5, 1)))
    with pytest.raises(TactileFailure, match="a wrench in a frame that is not stated, expected wrench_frame"):
        placed(robot, a_table(base_from_flange[None]), grasp)
    robot = replace(robot, gripper=replace(robot.gripper, wrench_frame=frame))
    recording, _ = placed(robot, a_table(base_from_flange[None]), grasp)
    expected = np.r_[FORCE_N, np.cross(AT_MM, FORCE_N)]
    np.testing.assert_allclose(recording.wrench_N, np.tile(expected, (5, 1)), atol=1e-9)


def test_the_recording_carries_the_spread_of_its_pads_places():
    recording, spreads = placed(
        exactly(), a_table((BASE_FROM_MAT @ UPRIGHT)[None]), a_grasp(np.full(5, 55.0))
    )
    assert recording.pose_sd_mm == max(spread.sd_mm for spread in spreads)
    assert recording.pose_sd_mm == pytest.approx(np.hypot(0.1, np.radians(0.05) * 155), rel=0.2)


def test_pads_off_the_mat_and_tables_of_another_grasp_are_refused():
    robot, grasp, flange = exactly(), a_grasp(np.full(5, 55.0)), BASE_FROM_MAT @ UPRIGHT
    with pytest.raises(TactileFailure, match="expected within 400 mm of its middle"):
        placed(robot, a_table(np.linalg.inv(flange)[None]), grasp)
    with pytest.raises(TactileFailure, match="above it"):
        placed(robot, a_table((BASE_FROM_MAT @ pose(0, 0, 20, 180, 0, 0))[None]), grasp)
    with pytest.raises(TactileFailure, match=r"found 3 rows, expected 1, or 5 as a\.h5 has"):
        placed(robot, a_table(np.array([flange] * 3)), grasp)
    late = a_table(np.array([flange] * 2), time_s=np.array([7.0, 9.0]))
    with pytest.raises(TactileFailure, match=r"times from 7 to 9 s, expected those of a\.h5"):
        placed(robot, late, grasp)
    with pytest.raises(TactileFailure, match="found the pads tip, expected left and right"):
        placed(robot, a_table(flange[None]), a_recording())


TURN = Rotation.from_euler("xyz", [170, 10, 40], degrees=True)
QUATERNION = ",".join(f"{x:.6f}" for x in TURN.as_quat())
ROWS = {
    "x_mm,y_mm,z_mm,qx,qy,qz,qw": f"500,-100,300,{QUATERNION}",
    "x_m;y_m;z_m;rx_rad;ry_rad;rz_rad": "0,5;-0,1;0,3;"
    + ";".join(f"{x:.6f}".replace(".", ",") for x in TURN.as_rotvec()),
    "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg": "500,-100,300,"
    + ",".join(f"{x:.6f}" for x in TURN.as_rotvec(degrees=True)),
    "x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg": "500,-100,300,170,10,40",
    "x_mm,y_mm,z_mm,roll_rad,pitch_rad,yaw_rad": "500,-100,300,"
    + ",".join(f"{x:.6f}" for x in np.radians([170, 10, 40])),
    "x_mm,y_mm,z_mm,r11,r12,r13,r21,r22,r23,r31,r32,r33": "500,-100,300,"
    + ",".join(f"{x:.4f}" for x in TURN.as_matrix().ravel()),
}


@pytest.mark.parametrize("header", ROWS)
def test_each_notation_of_a_pose_is_read(header: str, tmp_path: Path):
    (tmp_path / "poses.csv").write_text(f"{header}\n{ROWS[header]}\n")
    table = read_flange_table(tmp_path / "poses.csv")
    truth = np.eye(4)
    truth[:3, :3], truth[:3, 3] = TURN.as_matrix(), (500, -100, 300)
    np.testing.assert_allclose(table.base_from_flange[0], truth, atol=2e-4)


MIRRORED = "1,0,0,0,1,0,0,0,-1"


@pytest.mark.parametrize(
    ("header", "row", "words"),
    [
        ("x,y,z,qx,qy,qz,qw", "1,2,3,0,0,0,1", "expected columns x_mm, y_mm, z_mm or x_m"),
        ("x_mm,y_mm,z_mm,a,b,c", "1,2,3,0,0,0", "expected columns qx, qy, qz, qw or rx_rad"),
        ("x_mm,y_mm,z_mm,qx,qy,qz,qw", "0.5,-0.1,0.3,0,0,0,1", "at most 0.592 mm from the base"),
        ("x_m,y_m,z_m,qx,qy,qz,qw", "500,-100,300,0,0,0,1", "is x_m in another unit"),
        ("x_mm,y_mm,z_mm,qx,qy,qz,qw", "500,-100,300,0,0,0.1,1.2", "row 2: found a quaternion of another"),
        ("x_mm,y_mm,z_mm,rx_rad,ry_rad,rz_rad", "500,0,0,0,170,0", "is it in degrees"),
        ("x_mm,y_mm,z_mm,roll_rad,pitch_rad,yaw_rad", "500,0,0,0,10,170", "is it in degrees"),
        ("x_mm,y_mm,z_mm," + ",".join(f"r{i}{j}" for i in "123" for j in "123"), f"500,0,0,{MIRRORED}",
         "row 2: found a left-handed matrix"),
        ("x_mm,y_mm,z_mm,qx,qy,qz,qw", "500,,300,0,0,0,1", "row 2: found part of a pose"),
        ("x_mm,y_mm,z_mm,qx,qy,qz,qw", "500,abc,300,0,0,0,1", 'y_mm: found "abc" in row 2'),
    ],
)  # fmt: skip
def test_a_mistake_in_the_table_is_named(header: str, row: str, words: str, tmp_path: Path):
    (tmp_path / "poses.csv").write_text(f"{header}\n{row}\n")
    with pytest.raises(TactileFailure, match=words):
        read_flange_table(tmp_path / "poses.csv")


def test_a_left_handed_pad_is_refused(tmp_path: Path):
    pads = "[pads.tip]\npose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 90], [0, 0, 0, 1]]\n"
    (tmp_path / "gripper.toml").write_text(pads)
    with pytest.raises(TactileFailure, match="left-handed"):
        read_gripper(tmp_path / "gripper.toml")

"""`drupe robot` and `drupe convert --robot` on a simulated robot: files in, pad poses out."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

TESTS = Path(__file__).parent.parent
sys.path += [str(TESTS / "tactile"), str(TESTS / "recon")]
from mat_scene import photographed, ring
from simulated_robot import BASE_FROM_MAT, FLANGE_FROM_CAMERA, noisy, pose

from pipeline.cli import app
from recon.cameras.printed_mat import mat_mapping, standard_mat
from tactile.io.recording import read_recording, write_recording
from tactile.io.robot_file import read_robot

DATA = TESTS / "data" / "nectarine-grasp"
FLANGE_FROM_PAD = {"left": pose(0, -30, 150, 0, 0, 0), "right": pose(0, 30, 150, 180, 0, 0)}
"""At 60 mm, the pads' z towards each other along the flange's y."""
FLANGE_FROM_PAD["left"][:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
FLANGE_FROM_PAD["right"][:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def run(*words: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, [*map(str, words)])
    return done.exit_code, done.output + str(done.exception or "")


def quaternion_row(flange: np.ndarray) -> list[str]:
    return [f"{x:.5f}" for x in (*flange[:3, 3], *Rotation.from_matrix(flange[:3, :3]).as_quat())]


def write_gripper(folder: Path) -> Path:
    pads = "".join(f"[pads.{name}]\npose = {at.tolist()}\n" for name, at in FLANGE_FROM_PAD.items())
    (folder / "gripper.toml").write_text(f"pose_aperture_mm = 60.0\npose_sd_mm = 0.1\n{pads}")
    return folder / "gripper.toml"


def write_mat(folder: Path) -> Path:
    (folder / "mat.json").write_text(json.dumps(mat_mapping(standard_mat())))
    return folder / "mat.json"


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with twelve rendered photos, the table of their flange poses, gripper and mat."""
    folder, rng = tmp_path_factory.mktemp("robot"), np.random.default_rng(4)
    cameras = ring(12, width=640, height=480)
    rows = ["photo,x_mm,y_mm,z_mm,qx,qy,qz,qw"]
    for camera, photo in zip(cameras, photographed(cameras, egg=None, mat=standard_mat()), strict=True):
        cv2.imwrite(str(folder / camera.name), photo.image)
        flange = BASE_FROM_MAT @ np.linalg.inv(camera.cam_from_world) @ np.linalg.inv(FLANGE_FROM_CAMERA)
        rows.append(",".join([camera.name, *quaternion_row(noisy(flange, rng))]))
    (folder / "poses.csv").write_text("\n".join(rows))
    write_gripper(folder)
    write_mat(folder)
    return folder


def calibrated(folder: Path, out: Path, *more: str) -> tuple[int, str]:
    files = "--gripper", folder / "gripper.toml", "--mat", folder / "mat.json"
    return run("robot", folder / "poses.csv", out, *files, *more)


def test_photos_and_flange_poses_give_the_mats_place(photos: Path, tmp_path: Path) -> None:
    code, words = calibrated(photos, tmp_path / "robot.toml")
    assert code == 0, words
    robot = read_robot(tmp_path / "robot.toml")
    error = np.linalg.inv(robot.base_from_mat) @ BASE_FROM_MAT
    motion = np.r_[Rotation.from_matrix(error[:3, :3]).as_rotvec(), error[:3, 3]]
    assert motion @ np.linalg.solve(robot.covariance, motion) < 22.5  # chi-square of 6, 99.9 %
    assert "write pose_sd_mm = " in words
    print(words)


def write_recording_without_poses(path: Path) -> None:
    recording = read_recording(DATA / "grasp.h5")
    still = [replace(pad, pose=np.broadcast_to(np.eye(4), pad.pose.shape).copy()) for pad in recording.pads]
    write_recording(path, replace(recording, pads=tuple(still)))

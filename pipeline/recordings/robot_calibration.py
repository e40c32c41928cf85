"""`drupe robot`: determines the mat's pose in the robot's base from photos of the mat."""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.batch.cache import file_hash
from pipeline.batch.opening import read_mat
from pipeline.problem import refused
from pipeline.recordings.description_file import DescriptionKind
from recon.cameras.mat_poses import LONGEST_ERROR_PX, cameras_from_mat
from recon.cameras.photos import MOST_PHOTOS, Photo, read_photo
from recon.cameras.printed_mat import Mat, detect_tags
from tactile.readers.flange_table import FlangeTable, read_flange_table
from tactile.readers.pictures import unusable
from tactile.readers.robot_file import FORMAT, VERSION, Gripper, read_gripper, read_robot
from tactile.robot.base_and_mat import BaseAndMat, flange_covariance, place_sd_mm
from tactile.robot.hand_eye import Lens, MatView, hand_eye

ROBOT = DescriptionKind("# robot, written by drupe robot", "a robot that drupe robot wrote")
SPREADS = ("flange_sd_mm", "flange_sd_deg", "heldout_mm", "heldout_deg", "pixel_sd")
"""Errors of the fit that the description contains."""
FRUIT_MM = np.array([0.0, 0.0, 30.0])
"""Typical place of the pads in the mat's frame, mm: half a fruit's height above the mat's centre."""


def calibrate_robot(
    poses: Path,
    out: Path,
    *,
    mat: Path,
    gripper: Path,
    fixed_camera: bool,
    today: datetime.date,
    report: Callable[[str], None],
) -> tuple[str, ...]:
    """Writes the robot's description to `out` from a table of flange poses; returns a summary in sentences.

    The photos are in the table's folder. Raises TactileFailure or ReconFailure for unusable tables, photos
    and poses. Raises BatchRefused if `out` is no .toml, an input, or not a file of drupe robot.
    """
    if out.suffix.lower() != ".toml":
        raise refused(out, "is TOML; give a name that ends in .toml.")
    ROBOT.require_place(out, inputs=(poses, mat, gripper))
    table, printed, hand = read_flange_table(poses), read_mat(mat), read_gripper(gripper)
    photos = _photos(poses, table, printed, report)
    fitted = _photographed(poses, table, photos, printed, camera_on_flange=not fixed_camera, report=report)
    inputs = [poses, mat, gripper, *(poses.parent / photo.name for photo in photos)]
    ROBOT.put(out, _described(fitted, hand, inputs, today), read_robot)
    return _in_words(fitted, hand)


def _photos(poses: Path, table: FlangeTable, mat: Mat, report: Callable[[str], None]) -> tuple[Photo, ...]:
    if (names := table.photo) is None:
        raise unusable(poses.name, "no photos", "a column photo")
    for row, name in zip(table.row, names, strict=True):
        if not name or Path(name).name != name:
            expected = f"the name of a photo in the folder of {poses.name}, without a path"
            raise unusable(f"{poses.name}: photo", f'"{name[:60]}" in row {row}', expected)
        if names.count(name) > 1:
            raise unusable(f"{poses.name}: photo", f'"{name[:60]}" twice', "one row for each photo")
    if len(names) > MOST_PHOTOS:
        raise unusable(poses.name, f"{len(names)} photos", f"at most {MOST_PHOTOS}")
    made = []
    for name in names:
        photo = read_photo(poses.parent / name)
        made.append(replace(photo, tags=detect_tags(photo.image, mat)))
    report(f"{len(made)} photos with {sum(len(photo.tags[0]) for photo in made if photo.tags)} tags")
    return tuple(made)


def _photographed(
    poses: Path,
    table: FlangeTable,
    photos: Sequence[Photo],
    mat: Mat,
    *,
    camera_on_flange: bool,
    report: Callable[[str], None],
) -> BaseAndMat:
    placed = cameras_from_mat(photos, mat)
    left_out = [photo.name for k, photo in enumerate(photos) if k not in set(placed.used.tolist())]
    if left_out:
        report(f"left out, with too few clear tags: {', '.join(left_out)}")
    views = []
    for camera, k in zip(placed.cameras, placed.used.tolist(), strict=True):
        tags, corners_px = photos[k].tags or detect_tags(photos[k].image, mat)
        corners_mm = np.concatenate([mat.corners_mm[tag] for tag in tags.tolist()])
        seen_px = corners_px.reshape(-1, 2)
        near = np.linalg.norm(camera.project(corners_mm) - seen_px, axis=1) < LONGEST_ERROR_PX
        pose = table.base_from_flange[k] if table.known[k] else None
        views.append(
            MatView(
                name=f"row {table.row[k]} ({photos[k].name})",
                corners_mm=corners_mm[near],
                corners_px=seen_px[near],
                camera_from_mat=camera.cam_from_world,
                base_from_flange=pose,
            )
        )
    first = placed.cameras[0]
    x, y = first.middle_px
    lens = Lens(focal_px=first.focal_px, middle_px=(float(x), float(y)), k1=first.k1)
    return hand_eye(views, lens, camera_on_flange=camera_on_flange, source=poses.name)


def _described(
    fitted: BaseAndMat, gripper: Gripper, inputs: Sequence[Path], today: datetime.date
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "made": today.isoformat(),
        "poses": fitted.poses,
        "base_from_mat": fitted.base_from_mat.tolist(),
        "covariance": ((fitted.covariance + fitted.covariance.T) / 2).tolist(),
        **{name: getattr(fitted, name) for name in SPREADS},
        fitted.other_name: fitted.other.tolist(),
        "pose_aperture_mm": gripper.pose_aperture_mm,
        "pose_sd_mm": gripper.pose_sd_mm,
        **({} if gripper.wrench_frame is None else {"wrench_frame": gripper.wrench_frame}),
        "pads": {name: {"pose": pose.tolist()} for name, pose in gripper.pads.items()},
        "inputs": [{"name": path.name, "sha256": file_hash(path)} for path in inputs],
    }


def _in_words(fitted: BaseAndMat, gripper: Gripper) -> tuple[str, ...]:
    turn = np.degrees(np.sqrt(np.trace(fitted.covariance[:3, :3]) / 3))
    at_fruit = place_sd_mm(fitted.covariance, FRUIT_MM)
    flange = flange_covariance(fitted.flange_sd_mm, fitted.flange_sd_deg)
    reach = max(place_sd_mm(flange, pose[:3, 3]) for pose in gripper.pads.values())
    total = float(np.linalg.norm([at_fruit, reach, gripper.pose_sd_mm]))
    x, y, z = fitted.base_from_mat[:3, 3]
    lines = [
        f"the mat's middle is at x {x:.2f}, y {y:.2f}, z {z:.2f} mm in the robot's base, from {fitted.poses} "
        "poses",
        f"noise of one flange pose, per axis: {fitted.flange_sd_mm:.2g} mm and {fitted.flange_sd_deg:.2g} "
        f"degrees, corners of the photos {fitted.pixel_sd:.2g} px",
        f"poses predicted from the others deviate by {fitted.heldout_mm:.2g} mm and {fitted.heldout_deg:.2g} "
        "degrees (root mean square per axis)",
        f"standard deviation of a pad's place at the fruit, per axis: {total:.2g} mm ({at_fruit:.2g} mm from "
        f"the calibration, with {turn:.2g} degrees; {reach:.2g} mm from the flange; "
        f"{gripper.pose_sd_mm:.2g} mm from the gripper's drawing)",
        "drupe convert --robot writes it into the recordings, and drupe grade includes it in E's error bar",
    ]
    if gripper.pose_sd_mm == 0:
        lines.append(
            "the gripper's description has no pose_sd_mm, so the pads' places on the flange count as exact"
        )
    return tuple(lines)

"""A recording's pad poses from the flange's.

mat_from_pad = inv(base_from_mat) @ base_from_flange @ flange_from_pad
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactile.markers.gaps import poses_at
from tactile.readers.flange_table import FlangeTable
from tactile.readers.pictures import unusable
from tactile.readers.recording import Recording
from tactile.readers.robot_file import Robot
from tactile.robot.base_and_mat import flange_covariance, place_sd_mm
from tactile.tactile_failure import TactileFailure

FARTHEST_MM = 400.0
"""Largest distance of a pad from the mat's middle, mm: a large fruit, and a gripper wide open."""
UNDER_MM = 5.0
"""Largest depth of a pad's middle below the mat, mm."""
CLOCK_SLACK_S = 0.1
"""Seconds by which the flange's table may begin after, or end before, the recording: some of its rows."""


@dataclass(frozen=True, kw_only=True)
class PadSpread:
    """Standard deviations per axis of one pad's position (mm): the whole, and its parts by cause."""

    name: str
    sd_mm: float
    calibration_mm: float
    flange_mm: float
    gripper_mm: float


def with_robot_poses(
    recording: Recording, robot: Robot, table: FlangeTable, *, source: str, named: str
) -> tuple[Recording, tuple[PadSpread, ...]]:
    """The recording with its pads' poses in the mat's frame, and their standard deviations.

    If the table has `time_s`, the flange's poses (and `aperture_mm`) are interpolated at the recording's
    times. Otherwise it has one row for all frames, or one per frame. Each jaw moves along its z by half of
    the aperture's change; a press's tip is fixed on the flange. A wrench is transformed to the mat's frame.

    Raises TactileFailure if table, gripper and recording do not match, the wrench's frame is not stated, or
    the pads are far from the mat. `source` and `named` are the names of recording and table in failures.
    """
    flange, aperture_mm = _at_frames(table, recording, source=source, named=named)
    recording = recording if aperture_mm is None else replace(recording, aperture_mm=aperture_mm)
    names = [pad.name for pad in recording.pads]
    if set(names) != set(robot.gripper.pads):
        expected = f"{' and '.join(sorted(robot.gripper.pads))}, as the robot's description has"
        raise unusable(source, f"the pads {' and '.join(names)}", expected)
    if recording.loading == "grasp" and not recording.aperture_mm.any():
        expected = f"the aperture of each frame: add a column aperture_mm to {named}"
        raise unusable(f"{source}: aperture_mm", "zero in every frame", expected)
    closed_mm = (
        0.5 * (robot.gripper.pose_aperture_mm - recording.aperture_mm) * (recording.loading == "grasp")
    )
    mat_from_flange = np.linalg.inv(robot.base_from_mat) @ flange
    wrench_N = None
    if recording.wrench_N is not None:
        cell = {"flange": mat_from_flange, "base": np.linalg.inv(robot.base_from_mat)[None]}
        frame = robot.gripper.wrench_frame
        if frame is None:
            expected = 'wrench_frame = "flange" or "base" in the gripper\'s description and in the robot\'s'
            raise unusable(f"{source}: wrench_N", "a wrench in a frame that is not stated", expected)
        wrench_N = moved_wrench(cell[frame], recording.wrench_N)
    pads, spreads = [], []
    for pad in recording.pads:
        on_flange = np.tile(robot.gripper.pads[pad.name], (len(flange), 1, 1))
        on_flange[:, :3, 3] += closed_mm[:, None] * on_flange[:, :3, 2]
        pose = mat_from_flange @ on_flange
        middle = pose[len(pose) // 2, :3, 3]
        if not (np.linalg.norm(middle) < FARTHEST_MM and middle[2] > -UNDER_MM):
            raise _elsewhere(source, pad.name, middle)
        pads.append(replace(pad, pose=pose))
        spreads.append(_spread(pad.name, robot, middle, on_flange[len(pose) // 2, :3, 3]))
    sd_mm = max(spread.sd_mm for spread in spreads)
    placed = replace(recording, pads=tuple(pads), pose_frame="mat", pose_sd_mm=sd_mm, wrench_N=wrench_N)
    return placed, tuple(spreads)


def moved_wrench(
    to_from: Float[np.ndarray, "#t 4 4"], wrench_N: Float[np.ndarray, "t 6"]
) -> Float[np.ndarray, "t 6"]:
    """Force (N) and torque (N mm) in another frame, about its origin: R f and R m + p x R f."""
    force, torque = np.einsum("tij,tkj->kti", to_from[:, :3, :3], wrench_N.reshape(-1, 2, 3))
    return np.concatenate([force, torque + np.cross(to_from[:, :3, 3], force)], axis=1)


def _at_frames(
    table: FlangeTable, recording: Recording, *, source: str, named: str
) -> tuple[Float[np.ndarray, "t 4 4"], Float[np.ndarray, " t"] | None]:
    """base_from_flange of each frame, and the aperture if the table has it."""
    poses, time_s, frames = table.base_from_flange, table.time_s, recording.time_s
    if not table.known.all():
        row = table.row[int(np.argmin(table.known))]
        raise unusable(f"{named}: row {row}", "no pose", "a flange pose in every row")
    if time_s is None and len(poses) not in (1, len(frames)):
        expected = f"1, or {len(frames)} as {source} has frames, or a column time_s on its clock"
        raise unusable(named, f"{len(poses)} rows", expected)
    if len(poses) == 1 < len(frames) and table.aperture_mm is not None:
        expected = f"one for each frame of {source}: write rows with time_s, or remove the column"
        raise unusable(f"{named}: aperture_mm", "a single aperture", expected)
    if time_s is None or len(poses) == 1:
        return np.broadcast_to(poses, (len(frames), 4, 4)), table.aperture_mm
    if frames[0] < time_s[0] - CLOCK_SLACK_S or frames[-1] > time_s[-1] + CLOCK_SLACK_S:
        observed = f"times from {time_s[0]:g} to {time_s[-1]:g} s"
        expected = f"those of {source} ({frames[0]:g} to {frames[-1]:g} s) on the same clock"
        raise unusable(f"{named}: time_s", observed, expected)
    when = np.clip(frames, time_s[0], time_s[-1])
    aperture_mm = None if table.aperture_mm is None else np.interp(when, time_s, table.aperture_mm)
    return poses_at(when, time_s, poses), aperture_mm


def _spread(
    name: str, robot: Robot, on_mat: Float[np.ndarray, "3"], on_flange: Float[np.ndarray, "3"]
) -> PadSpread:
    """Standard deviations of a pad's position by the calibration, the flange's poses and the drawing."""
    parts = (
        place_sd_mm(robot.covariance, on_mat),
        place_sd_mm(flange_covariance(robot.flange_sd_mm, robot.flange_sd_deg), on_flange),
        robot.gripper.pose_sd_mm,
    )
    return PadSpread(
        name=name,
        sd_mm=float(np.linalg.norm(parts)),
        calibration_mm=parts[0],
        flange_mm=parts[1],
        gripper_mm=parts[2],
    )


def _elsewhere(source: str, pad: str, middle: Float[np.ndarray, "3"]) -> TactileFailure:
    x, y, z = middle
    observed = f"a pad at x {x:.0f}, y {y:.0f}, z {z:.0f} mm on the mat"
    expected = (
        f"within {FARTHEST_MM:g} mm of its middle and above it. Check the units, the pads' poses on the "
        "flange, and that the mat lies where it was calibrated"
    )
    return unusable(f"{source}: pads/{pad}", observed, expected)

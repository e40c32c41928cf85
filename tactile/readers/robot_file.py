"""Reads in TOML a gripper on a robot: the pads' poses on the flange, and the calibrated pose of the mat.

gripper.toml has the poses from the gripper's drawing. robot.toml, which `drupe robot` writes, has the same
tables and `base_from_mat`. Its covariance is that of a rotation (rad) and a translation (mm) in the mat's
axes (docs/formats.md).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactile.readers.recording import APERTURE, PADS_OF_LOADING
from tactile.readers.toml_table import Table, read_table
from tactile.tactile_failure import TactileProblem

FORMAT = "drupe-robot"
VERSION = 1
"""Of the file; docs/formats.md describes it."""
GRIPPER_KEYS = {"pose_aperture_mm", "pose_sd_mm", "wrench_frame", "pads"}
ROBOT_KEYS = GRIPPER_KEYS | {
    "format", "version", "made", "base_from_mat", "covariance", "flange_sd_mm", "flange_sd_deg", "poses",
    "heldout_mm", "heldout_deg", "pixel_sd", "flange_from_camera", "base_from_camera",
    "inputs",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """`pads`: flange_from_pad (mm) by name, at `pose_aperture_mm`; `pose_sd_mm`: their standard deviation per
    axis. `wrench_frame`: "flange" or "base", whose axes and origin the load cell uses; None: not stated.
    """

    pads: dict[str, Float[np.ndarray, "4 4"]]
    pose_aperture_mm: float
    pose_sd_mm: float
    wrench_frame: str | None = None


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A gripper and the pose of the mat in its robot's base (tactile.robot.base_and_mat.BaseAndMat)."""

    gripper: Gripper
    base_from_mat: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    flange_sd_mm: float
    flange_sd_deg: float


def read_gripper(path: Path) -> Gripper:
    """The gripper that `path` describes; raises TactileFailure (unreadable-sensor)."""
    top = read_table(path, TactileProblem.UNREADABLE_SENSOR, what="a gripper's description")
    top.refuse_unknown(GRIPPER_KEYS)
    return _gripper(top)


def read_robot(path: Path) -> Robot:
    """The robot that `drupe robot` described in `path`; raises TactileFailure (unreadable-sensor)."""
    top = read_table(path, TactileProblem.UNREADABLE_SENSOR, what="a robot's description (drupe robot)")
    top.require_format(FORMAT, VERSION)
    top.refuse_unknown(ROBOT_KEYS)
    covariance = top.numbers("covariance", (6, 6))
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance).min() <= 0:
        raise top.refusal("covariance", "a matrix that is no covariance", "a symmetric, positive one")
    return Robot(
        gripper=_gripper(top),
        base_from_mat=_pose(top, "base_from_mat"),
        covariance=covariance,
        flange_sd_mm=_spread(top, "flange_sd_mm"),
        flange_sd_deg=_spread(top, "flange_sd_deg"),
    )


def _gripper(top: Table) -> Gripper:
    pads = top.table("pads", needed=True)
    pads.refuse_unknown([name for names in PADS_OF_LOADING.values() for name in names])
    poses = {}
    for name in pads.values:
        table = pads.table(name, needed=True)
        table.refuse_unknown({"pose"})
        poses[name] = _pose(table, "pose")
    if tuple(sorted(poses)) not in PADS_OF_LOADING.values():
        raise top.refusal("pads", " and ".join(sorted(poses)), "left and right, or tip alone")
    at_mm = top.number("pose_aperture_mm", needed="tip" not in poses, above=-APERTURE.largest)
    return Gripper(
        pads=poses,
        pose_aperture_mm=at_mm or 0.0,
        pose_sd_mm=_spread(top, "pose_sd_mm"),
        wrench_frame=top.choice("wrench_frame", ("flange", "base")) if "wrench_frame" in top.values else None,
    )


def _pose(table: Table, name: str) -> Float[np.ndarray, "4 4"]:
    pose = table.numbers(name, (4, 4))
    if np.linalg.det(pose[:3, :3]) < 0:
        raise table.refusal(name, "a left-handed matrix (determinant -1)", "a right-handed rotation")
    return table.pose(name)


def _spread(table: Table, name: str) -> float:
    """A standard deviation; 0 if it is missing."""
    value = table.number(name, needed=False, above=-1e-12)
    return value or 0.0

"""Pose of the mat in the robot's base, its error, and checks of the flange's poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from tactile.tactile_failure import TactileFailure, TactileProblem

LEAST_TURN_DEG = 5.0
"""Degrees (root mean square) by which the flange must turn about a second axis. Errors of position grow with
the reciprocal of this turn: 0.1 degrees of noise over 5 degrees is 2 % of the distance. Set by hand."""
MOST_SD_MM, MOST_SD_DEG = 2.0, 1.0
"""These are the largest deviations (root mean square) of flange poses that pass as noise: some ten times what
robots and printed mats have. Beyond, poses and pictures belong to different frames. Set by hand."""
OUTLIER = 6.0
"""A pose that deviates by more than this many times the median is not noise: 1e-6 of normal poses do."""
FOLDS = 5
"""Parts of the poses; each is predicted from the others."""


@dataclass(frozen=True, kw_only=True)
class BaseAndMat:
    """`base_from_mat` (mm), and `covariance` of a turn (rad) and shift (mm) in the mat's axes applied first:
    true pose = base_from_mat @ [turn, shift].

    `flange_sd_mm`, `flange_sd_deg`: noise of a single flange pose, per axis, as the deviations show it.
    `heldout_mm`, `heldout_deg`: root mean square deviation per axis of poses that were predicted from the
    others. `pixel_sd`: of a corner in a picture, px. `other_name`, `other`: the camera's frame, which the
    calibration found too.
    """

    base_from_mat: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    flange_sd_mm: float
    flange_sd_deg: float
    heldout_mm: float
    heldout_deg: float
    pixel_sd: float
    poses: int
    other_name: str
    other: Float[np.ndarray, "4 4"]


def refused(source: str, observed: str, expected: str, advice: str) -> TactileFailure:
    """The failure of a calibration: what was found, what was expected, what to do."""
    return TactileProblem.UNREADABLE_FRAMES.failure(
        f"{source}: found {observed}, expected {expected}. {advice}"
    )


def rigid(turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """The 4x4 matrix of a rotation and a shift."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    return pose


def small_motion(step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """The matrix of a rotation vector (rad) and a shift."""
    return rigid(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:])


def motion_slopes(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 6"]:
    """Change of each point with a turn (rad) and a shift (mm).

    >>> motion_slopes(np.array([[2.0, 0.0, 0.0]]))[0, :, 2].tolist()
    [0.0, 2.0, 0.0]
    """
    turned = np.swapaxes(np.cross(np.eye(3), points[:, None]), 1, 2)
    return np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2)


def flange_covariance(sd_mm: float, sd_deg: float) -> Float[np.ndarray, "6 6"]:
    """Covariance of a rotation (rad) and a translation (mm) with these standard deviations per axis."""
    return np.diag(np.repeat([np.radians(sd_deg) ** 2, sd_mm**2], 3))


def place_sd_mm(covariance: Float[np.ndarray, "6 6"], place_mm: Float[np.ndarray, "3"]) -> float:
    """Standard deviation per axis (mm) of a point under motions with this covariance, in the same axes."""
    moved = motion_slopes(place_mm[None])[0]
    return float(np.sqrt(np.trace(moved @ covariance @ moved.T) / 3))


def require_turns(base_from_flange: Float[np.ndarray, "n 4 4"], *, fewest: int, source: str) -> None:
    """Refuses poses that cannot separate the two unknown frames: too few, or turned about one axis alone.

    Turns about two axes at least are necessary (Tsai and Lenz 1989, IEEE Trans. Robot. Autom. 5:345). The
    spread about the second axis is the second singular value of the rotation vectors from the mean.
    """
    count = len(base_from_flange)
    if count < fewest:
        advice = "Add poses that differ in tilt and place."
        raise refused(source, f"{count} usable poses", f"at least {fewest}", advice)
    turns = Rotation.from_matrix(base_from_flange[:, :3, :3])
    vectors = (turns.mean().inv() * turns).as_rotvec(degrees=True)
    second = float(np.linalg.svd(vectors, compute_uv=False)[1] / np.sqrt(count))
    if second < LEAST_TURN_DEG:
        observed = (
            f"flange rotations that differ by {second:.2g} degrees about a second axis (root mean square)"
        )
        advice = "Tilt the flange by 20 degrees or more about two axes between the poses."
        raise refused(source, observed, f"at least {LEAST_TURN_DEG:g}", advice)


def require_noise(
    names: Sequence[str],
    shift_mm: Float[np.ndarray, "n 3"],
    turn_deg: Float[np.ndarray, "n 3"],
    *,
    source: str,
    advice: str,
) -> None:
    """Refuses deviations of flange poses that are not noise, and names the worst pose if it stands out."""
    size = np.hypot(
        np.linalg.norm(shift_mm, axis=1) / MOST_SD_MM, np.linalg.norm(turn_deg, axis=1) / MOST_SD_DEG
    )
    worst = int(np.argmax(size))
    apart = f"{np.linalg.norm(shift_mm[worst]):.2g} mm and {np.linalg.norm(turn_deg[worst]):.2g} degrees"
    if size[worst] > OUTLIER * np.median(size) and size[worst] > 1:
        say = "Correct or remove this row."
        raise refused(source, f"{names[worst]} {apart} off the other poses", "poses that agree", say)
    mm, deg = (float(np.sqrt(np.mean(values**2))) for values in (shift_mm, turn_deg))
    if mm > MOST_SD_MM or deg > MOST_SD_DEG:
        observed = f"poses that disagree by {mm:.2g} mm and {deg:.2g} degrees (worst: {names[worst]})"
        raise refused(source, observed, f"at most {MOST_SD_MM:g} mm and {MOST_SD_DEG:g} degrees", advice)


def folds(count: int) -> list[Int[np.ndarray, " _"]]:
    """Indices of the poses in each part, every FOLDS-th."""
    return [np.arange(start, count, FOLDS) for start in range(min(FOLDS, count))]

"""Where the mat lies in the robot's base, how well that is known, and checks of both calibrations.

Touches of the mat's corners with a finger tip tell it: base_from_flange @ tip = base_from_mat @ corner for
each touch, with the tip's place on the flange unknown. Pictures tell it in tactile/robot/hand_eye.py.
"""

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
FEWEST_TOUCHES = 8
"""24 equations for 9 unknowns leave enough to measure the noise. Set by hand."""
LEAST_SPREAD_MM = 20.0
"""mm (root mean square) of the corners along the narrow side: 0.2 mm of noise over it turns the mat by half a
degree. Set by hand."""
STEPS = 6
"""Gauss and Newton's, from a start that is right to the noise: the error is squared in each."""
MOST_SCALE = 1.2
"""Largest ratio of distances in the robot's base to those on the mat; a wrong unit makes it 10 or more."""


@dataclass(frozen=True, kw_only=True)
class BaseAndMat:
    """`base_from_mat` (mm), and `covariance` of a turn (rad) and shift (mm) in the mat's axes applied first:
    true pose = base_from_mat @ [turn, shift].

    `flange_sd_mm`, `flange_sd_deg`: noise of a single flange pose, per axis, as the deviations show it.
    `heldout_mm`, `heldout_deg`: root mean square deviation per axis of poses that were predicted from the
    others. `pixel_sd`: of a corner in a picture, px; 0 without pictures. `other_name`, `other`: the second
    frame that the calibration found (a camera or a finger tip).
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
    return TactileFailure(
        TactileProblem.UNREADABLE_FRAMES, f"{source}: found {observed}, expected {expected}. {advice}"
    )


def rigid(turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """The 4x4 matrix of a rotation and a shift."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    return pose


def small_motion(step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """The matrix of a rotation vector (rad) and a shift."""
    return rigid(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:])


def cross_matrix(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """For each point p the matrix of v -> p x v.

    >>> (cross_matrix(np.array([[0.0, 0.0, 1.0]]))[0] @ [1.0, 0.0, 0.0]).tolist()
    [0.0, 1.0, 0.0]
    """
    x, y, z = points.T
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)


def motion_slopes(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 6"]:
    """Change of each point with a turn (rad) and a shift (mm)."""
    return np.concatenate([-cross_matrix(points), np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)


def flange_covariance(sd_mm: float, sd_deg: float) -> Float[np.ndarray, "6 6"]:
    """Of a turn (rad) and a shift (mm) with these standard deviations per axis."""
    return np.diag(np.repeat([np.radians(sd_deg) ** 2, sd_mm**2], 3))


def place_sd_mm(covariance: Float[np.ndarray, "6 6"], place_mm: Float[np.ndarray, "3"]) -> float:
    """Standard deviation per axis (mm) of a point, in the axes of `covariance`, that turns and shifts."""
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
    """Numbers of the poses in each part, every FOLDS-th."""
    return [np.arange(start, count, FOLDS) for start in range(min(FOLDS, count))]


def touched_mat(
    names: Sequence[str],
    base_from_flange: Float[np.ndarray, "n 4 4"],
    corners_mm: Float[np.ndarray, "n 3"],
    *,
    source: str,
) -> BaseAndMat:
    """base_from_mat and the tip's place on the flange by least squares over all touches (mm).

    The noise of a touch is that of the residuals; it includes the flange's turns. Raises TactileFailure for
    too few or too similar poses, corners that span no area, wrong units, corners in mirrored order, and
    touches that disagree.
    """
    require_turns(base_from_flange, fewest=FEWEST_TOUCHES, source=source)
    spread_mm = np.linalg.svd(corners_mm - corners_mm.mean(axis=0), compute_uv=False)[1] / len(names) ** 0.5
    if spread_mm < LEAST_SPREAD_MM:
        observed = f"corners that spread by {spread_mm:.2g} mm along the narrow side (root mean square)"
        advice = "Touch corners on all sides of the mat."
        raise refused(source, observed, f"at least {LEAST_SPREAD_MM:g} mm", advice)
    frame, tip = _start(base_from_flange, corners_mm, source)
    frame, tip, inverse, miss = _fitted(base_from_flange, corners_mm, frame, tip)
    advice = "Check the numbers of tags and corners: corner 0 is the tag's top left, then clockwise."
    require_noise(names, miss, np.zeros_like(miss), source=source, advice=advice)
    heights = (np.linalg.inv(frame) @ base_from_flange)[:, 2, 3]
    if np.median(heights) < 0:
        observed = "a flange below the mat"
        raise refused(
            source, observed, "one above it during the touches: is the order of corners mirrored", advice
        )
    free = miss.size - 9
    sd_mm = float(np.sqrt(np.sum(miss**2) / free))
    ahead = []
    for part in folds(len(names)):
        keep = np.delete(np.arange(len(names)), part)
        other, its_tip, *_ = _fitted(base_from_flange[keep], corners_mm[keep], frame, tip)
        ahead.append(_misses(base_from_flange[part], corners_mm[part], other, its_tip))
    return BaseAndMat(
        base_from_mat=frame,
        covariance=sd_mm**2 * free / (free - 2) * inverse[:6, :6],  # Student's t over the normal's variance
        flange_sd_mm=sd_mm,
        flange_sd_deg=0.0,
        heldout_mm=float(np.sqrt(np.mean(np.concatenate(ahead) ** 2))),
        heldout_deg=0.0,
        pixel_sd=0.0,
        poses=len(names),
        other_name="flange_from_tip",
        other=rigid(np.eye(3), tip),
    )


def _start(
    poses: Float[np.ndarray, "n 4 4"], corners: Float[np.ndarray, "n 3"], source: str
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"]]:
    """Both unknowns by linear least squares, the mat's axes free; refuses another unit by their lengths."""
    eye = np.broadcast_to(np.eye(3), (len(poses), 3, 3))
    axes = [-corners[:, k, None, None] * eye for k in (0, 1)]
    design = np.concatenate([poses[:, :3, :3], -eye, *axes], axis=2).reshape(-1, 12)
    tip, origin, x, y = np.linalg.lstsq(design, -poses[:, :3, 3].ravel(), rcond=None)[0].reshape(4, 3)
    scale = float(np.sqrt(np.linalg.norm(x) * np.linalg.norm(y)))
    if not 1 / MOST_SCALE < scale < MOST_SCALE:
        observed = f"distances that are {scale:.3g} times those on the mat"
        advice = "Check the units (mm or m, in the names of the columns) and the numbers of tags and corners."
        raise refused(source, observed, "equal distances", advice)
    left, _, right = np.linalg.svd(np.column_stack([x, y]), full_matrices=False)
    plane = left @ right
    return rigid(np.column_stack([plane, np.cross(*plane.T)]), origin), tip


def _fitted(
    poses: Float[np.ndarray, "n 4 4"],
    corners: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "4 4"],
    tip: Float[np.ndarray, "3"],
) -> tuple[
    Float[np.ndarray, "4 4"], Float[np.ndarray, "3"], Float[np.ndarray, "9 9"], Float[np.ndarray, "n 3"]
]:
    """base_from_mat, the tip, their covariance per mm², and the residuals (mm)."""
    by_mat = motion_slopes(corners)
    for _ in range(STEPS):
        slopes = np.concatenate([-frame[:3, :3] @ by_mat, poses[:, :3, :3]], axis=2).reshape(-1, 9)
        step = np.linalg.lstsq(slopes, -_misses(poses, corners, frame, tip).ravel(), rcond=None)[0]
        frame, tip = frame @ small_motion(step[:6]), tip + step[6:]
    return frame, tip, np.linalg.inv(slopes.T @ slopes), _misses(poses, corners, frame, tip)


def _misses(
    poses: Float[np.ndarray, "n 4 4"],
    corners: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "4 4"],
    tip: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "n 3"]:
    touched = poses[:, :3, :3] @ tip + poses[:, :3, 3]
    return np.asarray(touched - (corners @ frame[:3, :3].T + frame[:3, 3]))

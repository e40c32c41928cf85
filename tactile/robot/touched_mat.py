"""Touches of the mat's corners with a finger tip tell where the mat lies in the robot's base.

base_from_flange @ tip = base_from_mat @ corner for each touch, with the tip's place on the flange unknown.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactile.robot.base_and_mat import (
    BaseAndMat,
    folds,
    motion_slopes,
    refused,
    require_noise,
    require_turns,
    rigid,
    small_motion,
)

FEWEST_TOUCHES = 8
"""24 equations for 9 unknowns leave enough to measure the noise. Set by hand."""
LEAST_SPREAD_MM = 20.0
"""mm (root mean square) of the corners along the narrow side: 0.2 mm of noise over it turns the mat by half a
degree. Set by hand."""
STEPS = 6
"""Gauss and Newton's, from a start that is right to the noise: the error is squared in each."""
MOST_SCALE = 1.2
"""Largest ratio of distances in the robot's base to those on the mat; a wrong unit makes it 10 or more."""


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

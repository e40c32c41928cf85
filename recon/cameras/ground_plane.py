"""The plane of most points, on which a fruit without a mat stands."""

import numpy as np
from jaxtyping import Float

from recon.cameras.similarity import affine
from recon.recon_failure import ReconProblem

TRIALS = 600
"""Tried planes through three points; if a quarter is ground, all miss it with a probability of 0.01 %."""
FEWEST_POINTS = 15
"""Least number of points on the plane; fewer may share one by chance. Set by hand."""
STEEPEST_DEG = 10.0
"""Degrees from the vertical within which the first photo's azimuth is undefined. Set by hand."""


def ground_plane(
    points: Float[np.ndarray, "n 3"],
    *,
    tolerance: float,
    above: Float[np.ndarray, "m 3"],
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """A point and the upward unit normal of the plane with the most points within `tolerance` (RANSAC).

    The camera centres `above` must lie on one side of it, which is up. Raises ReconFailure (no-overlap) if
    fewer than fifteen points share a plane.
    """
    best, count = np.zeros(len(points), bool), 0
    for _ in range(TRIALS if len(points) >= FEWEST_POINTS else 0):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < tolerance**2:
            continue
        normal /= length
        close = np.abs((points - a) @ normal) < tolerance
        if close.sum() <= count:
            continue
        side = (above - a) @ normal
        if np.abs(side.sum()) < 0.95 * np.abs(side).sum():
            continue
        best, count = close, int(close.sum())
    if count < FEWEST_POINTS:
        raise ReconProblem.NO_OVERLAP.failure(
            f"drupe found no flat ground under the fruit among {len(points)} points; use the mat "
            "(drupe mat) or a flat, textured ground."
        )
    for _ in range(5):
        middle = points[best].mean(0)
        normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][2]
        best = np.abs((points - middle) @ normal) < 0.7 * tolerance
    side = (above - middle) @ normal
    return middle, normal if np.sum(np.sign(side) * (np.abs(side) > tolerance)) >= 0 else -normal


def upright(
    up: Float[np.ndarray, "3"], foot: Float[np.ndarray, "3"], ahead: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """The rigid transform that moves `foot` to the origin, `up` to z, and `ahead`, made horizontal, to x.

    Without a mat `ahead` points to the first photo's camera, by convention on the suture's side. Raises
    ReconFailure (no-overlap) within ten degrees of the vertical, where it has no azimuth.
    """
    x = ahead - (ahead @ up) * up
    if not np.linalg.norm(x) > np.sin(np.radians(STEEPEST_DEG)) * np.linalg.norm(ahead):
        raise ReconProblem.NO_OVERLAP.failure(
            "The first photo looks straight down on the fruit. Without a mat it must show the "
            "suture's side, because it defines the suture's direction. Retake the first photo, or "
            "use the mat (drupe mat)."
        )
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(up, x), up])
    return affine(turn, -turn @ foot)

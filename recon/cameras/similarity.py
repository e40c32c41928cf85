"""Similarity transforms (rotation, scale, shift) between sets of points."""

import cv2
import numpy as np
from jaxtyping import Float


def fitted_similarity(
    source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, " n"]]:
    """target_from_source by least sum |target - (s R source + t)|² (Umeyama 1991, PAMI 13:376); residuals.

    >>> T, away = fitted_similarity(np.eye(3), 2 * np.eye(3) + 1)
    >>> round(float(np.cbrt(np.linalg.det(T[:3, :3]))), 9), bool(away.max() < 1e-9)
    (2.0, True)
    """
    solved, scale = cv2.estimateAffine3D(source, target, force_rotation=True)
    T = affine(scale * solved[:, :3], solved[:, 3])
    return T, np.linalg.norm(moved(source, T) - target, axis=1)


def robust_similarity(
    source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, " m"]]:
    """`fitted_similarity` without pairs over three times the median residual, and the other residuals."""
    keep = np.ones(len(source), bool)
    for _ in range(8):
        T, _ = fitted_similarity(source[keep], target[keep])
        away = np.linalg.norm(moved(source, T) - target, axis=1)
        keep = away <= 3 * float(np.median(away)) + 1e-12
    return T, away[keep]


def affine(linear: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """The transform that takes x to linear x + shift."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = linear, shift
    return T


def scaling(factor: float) -> Float[np.ndarray, "4 4"]:
    """The transform that scales about the origin."""
    return np.diag([factor, factor, factor, 1.0])


def moved(points: Float[np.ndarray, "*n 3"], T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "*n 3"]:
    """Points transformed by a 4x4 matrix.

    >>> moved(np.array([[1.0, 2, 3]]), np.diag([2.0, 2, 2, 1]))
    array([[2., 4., 6.]])
    """
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])

"""Cameras of a geometry model: from its pose_enc, or from how its points lie in a picture."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

FEWEST_PLACED = 30
"""Points of a picture that its camera is worked out from, at least. Set by hand."""


def unprojected(
    depth: Float[np.ndarray, "s h w"], pose: Float[np.ndarray, "s 9"]
) -> Float[np.ndarray, "s h w 3"]:
    """X = R' (d K^-1 (u, v, 1) - t) with f = size / (2 tan(angle of view / 2))."""
    _, rows, columns = depth.shape
    v, u = np.mgrid[:rows, :columns] + 0.5
    points = np.empty((*depth.shape, 3))
    for i, (d, p) in enumerate(zip(depth, np.asarray(pose, float), strict=True)):
        x = (u - columns / 2) / (columns / 2) * np.tan(p[8] / 2)
        y = (v - rows / 2) / (rows / 2) * np.tan(p[7] / 2)
        local = np.stack([x * d, y * d, d], axis=-1) - p[:3]
        points[i] = local @ Rotation.from_quat(p[3:7]).as_matrix()
    return points


def camera_places(pose: Float[np.ndarray, "s 9"]) -> Float[np.ndarray, "s 3"]:
    """Camera centres -R' t."""
    return np.asarray(-Rotation.from_quat(pose[:, 3:7]).apply(pose[:, :3], inverse=True))


def first_place(
    points: Float[np.ndarray, "h w 3"], trust: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "1 3"] | None:
    """The camera's centre from its point map: the null vector of the 3 x 4 P with P (X, 1) ~ (u, v, 1).

    P by the direct linear transform (Hartley and Zisserman, Multiple View Geometry, 2nd ed., algorithm 7.1)
    from up to 2,000 of the more trusted points, thrice, twice without those over three times the median off.
    """
    known = np.isfinite(trust)
    if known.sum() < FEWEST_PLACED:
        return None
    rows, columns = np.nonzero(known & (trust >= np.median(trust[known])))
    some = np.linspace(0, len(rows) - 1, min(2000, len(rows))).astype(int)
    X, at = points[rows[some], columns[some]], np.stack([columns[some], rows[some]], axis=1).astype(float)
    keep = np.ones(len(X), bool)
    for _ in range(3):
        size, middle = X[keep].std() + 1e-12, X[keep].mean(0)
        wide, centre = at[keep].std() + 1e-12, at[keep].mean(0)
        h = np.column_stack([(X - middle) / size, np.ones(len(X))])
        uv = (at - centre) / wide
        zero = np.zeros_like(h)
        A = np.concatenate([np.hstack([h, zero, -uv[:, :1] * h]), np.hstack([zero, h, -uv[:, 1:] * h])])
        singular, V = np.linalg.svd(A[np.concatenate([keep, keep])], full_matrices=False)[1:]
        P = V[-1].reshape(3, 4)
        seen = h @ P.T
        away = np.linalg.norm(
            seen[:, :2] / np.where(np.abs(seen[:, 2:]) < 1e-12, 1e-12, seen[:, 2:]) - uv, axis=1
        )
        keep = away <= 3 * float(np.median(away)) + 1e-9
    null = np.linalg.svd(P)[2][-1]
    if singular[-2] < 1e-6 * singular[0] or abs(null[3]) < 1e-9:
        return None
    return np.asarray((null[:3] / null[3] * size + middle)[None])

"""Fills gaps: values of hidden markers from their neighbours, values and poses between recorded times."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

AROUND = 6
"""Nearest known markers from which a missing value is computed: about the neighbours on a grid."""


def filled(
    rest_mm: Float[np.ndarray, "n 3"], values: Float[np.ndarray, "t n 3"]
) -> Float[np.ndarray, "t n 3"]:
    """`values` with each NaN marker replaced by a weighted mean of the six nearest known ones in its frame.

    Weights fall with the square of the distance. Every frame must have a known marker.
    """
    whole = values.copy()
    for t in np.flatnonzero(~np.isfinite(values).all(axis=(1, 2))):
        known = np.isfinite(values[t]).all(axis=1)
        k = min(AROUND, int(known.sum()))
        away, which = cKDTree(rest_mm[known]).query(rest_mm[~known], k=list(range(1, k + 1)))
        weight = 1.0 / np.maximum(np.asarray(away), 1e-9) ** 2
        near = values[t, known][np.asarray(which)]
        whole[t, ~known] = np.einsum("mk,mkc->mc", weight, near) / weight.sum(axis=1)[:, None]
    return whole


def at_times(
    when: Float[np.ndarray, " t"], time_s: Float[np.ndarray, " s"], values: Float[np.ndarray, " s *c"]
) -> Float[np.ndarray, " t *c"]:
    """`values` at the times `when`: linear interpolation, constant beyond the ends; equal times change
    nothing.

    >>> at_times(np.array([0.5]), np.array([0.0, 1.0]), np.array([10.0, 20.0]))
    array([15.])
    """
    if len(when) == len(time_s) and np.array_equal(when, time_s):
        return values
    later = np.clip(np.searchsorted(time_s, when), 1, len(time_s) - 1)
    share = np.clip((when - time_s[later - 1]) / (time_s[later] - time_s[later - 1]), 0.0, 1.0)
    share = share.reshape(-1, *([1] * (values.ndim - 1)))
    return np.asarray(values[later - 1] * (1.0 - share) + values[later] * share)


def poses_at(
    when: Float[np.ndarray, " t"], time_s: Float[np.ndarray, " s"], pose: Float[np.ndarray, "s 4 4"]
) -> Float[np.ndarray, "t 4 4"]:
    """Rigid transforms at other times (s): linear translation, rotation at a constant rate (slerp).

    `when` lies within `time_s`, which increases and has two times or more.
    """
    moved = np.tile(np.eye(4), (len(when), 1, 1))
    moved[:, :3, :3] = Slerp(time_s, Rotation.from_matrix(pose[:, :3, :3]))(when).as_matrix()
    moved[:, :3, 3] = np.column_stack([np.interp(when, time_s, axis) for axis in pose[:, :3, 3].T])
    return moved

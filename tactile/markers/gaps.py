"""Values of markers that were not seen, from those around them; values and poses between the times at which
they are known.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

AROUND = 6
"""Neighbours from whose values a missing one is taken: those next to it on a grid, about."""


def filled(
    rest_mm: Float[np.ndarray, "n 3"], values: Float[np.ndarray, "t n 3"]
) -> Float[np.ndarray, "t n 3"]:
    """`values` with every NaN replaced by the mean of the six nearest known markers of its frame.

    Weights fall with the square of the distance. A frame without any known marker must not be given.
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
    """`values` at other times, linear in between; unchanged where the times are the same.

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
    """Rigid transforms at other times (s): shifts linear in between, turns at a constant rate.

    `when` lies within `time_s`, which has two times or more and increases.
    """
    moved = np.tile(np.eye(4), (len(when), 1, 1))
    moved[:, :3, :3] = Slerp(time_s, Rotation.from_matrix(pose[:, :3, :3]))(when).as_matrix()
    moved[:, :3, 3] = np.column_stack([np.interp(when, time_s, axis) for axis in pose[:, :3, 3].T])
    return moved

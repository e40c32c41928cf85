"""Poses between the times at which they are known."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp


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

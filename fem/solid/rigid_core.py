"""The pit as a rigid body: all displacements follow from the free nodes' and six pit motions, u = T q."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array


def rigid_modes(
    points_mm: Float[np.ndarray, "p 3"], *, centre_mm: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "p 3 6"]:
    """Displacement of each point under unit translations (mm) and unit rotations (rad) about the centre.

    u = t + w x (x - c); columns t_x, t_y, t_z, w_x, w_y, w_z.

    A unit rotation about z moves a point at x = 2 by 2 along y.

    >>> rigid_modes(np.array([[2.0, 0, 0]]), centre_mm=np.zeros(3))[0, :, 5]
    array([0., 2., 0.])
    """
    arm = points_mm - centre_mm
    modes = np.zeros((len(points_mm), 3, 6))
    modes[:, :, :3] = np.eye(3)
    for k in range(3):
        modes[:, :, 3 + k] = np.cross(np.eye(3)[k], arm)
    return modes


def pit_centre_mm(
    nodes_mm: Float[np.ndarray, "n 3"], pit_nodes: Int[np.ndarray, " p"]
) -> Float[np.ndarray, "3"]:
    """The point about which pit rotations are counted: the mean of the pit's nodes."""
    return np.asarray(nodes_mm[pit_nodes].mean(axis=0))


def reduction(nodes_mm: Float[np.ndarray, "n 3"], pit_nodes: Int[np.ndarray, " p"]) -> csr_array:
    """T (3 n, d) of u = T q: q holds the free nodes' dofs in order, then six pit motions if there is a pit.

    Pit rotations are about `pit_centre_mm`, in radians. Without a pit T is the identity.
    """
    n = len(nodes_mm)
    is_free = np.ones(n, dtype=bool)
    is_free[pit_nodes] = False
    free = np.flatnonzero(np.repeat(is_free, 3))
    row, column, value = [free], [np.arange(len(free))], [np.ones(len(free))]
    if len(pit_nodes):
        modes = rigid_modes(nodes_mm[pit_nodes], centre_mm=pit_centre_mm(nodes_mm, pit_nodes))
        pit_dofs = (3 * pit_nodes[:, None] + np.arange(3)).ravel()
        row.append(np.repeat(pit_dofs, 6))
        column.append(np.tile(len(free) + np.arange(6), len(pit_dofs)))
        value.append(modes.reshape(-1))
    width = len(free) + (6 if len(pit_nodes) else 0)
    entries = (np.concatenate(value), (np.concatenate(row), np.concatenate(column)))
    matrix = coo_array(entries, shape=(3 * n, width)).tocsr()
    matrix.eliminate_zeros()
    return matrix


def reduced(stiffness: csr_array, kinematics: csr_array) -> csr_array:
    """T' K T. Rows of T that pick one q are carried over as they are; only the others are multiplied."""
    if kinematics.nnz == 0:
        return csr_array(kinematics.T @ stiffness @ kinematics)
    length = np.diff(kinematics.indptr)
    first = np.minimum(kinematics.indptr[:-1], kinematics.nnz - 1)
    picks = (length == 1) & (kinematics.data[first] == 1)
    target = np.where(picks, kinematics.indices[first], -1)
    chosen = target[picks]
    if not (np.diff(chosen) > 0).all():
        return csr_array(kinematics.T @ stiffness @ kinematics)
    picked = _carried_over(stiffness, target, kinematics.shape[1])
    others = kinematics.copy()
    others.data = np.where(np.repeat(picks, length), 0, others.data)
    others.eliminate_zeros()
    if others.nnz == 0:
        return picked
    tied = csr_array(stiffness @ others)
    mixed = csr_array((kinematics - others).T @ tied)
    return csr_array(picked + (mixed + mixed.T) + others.T @ tied)


def _carried_over(matrix: csr_array, target: Int[np.ndarray, " d"], width: int) -> csr_array:
    """Entries of rows and columns with a target, moved there; the targets ascend."""
    column = target[matrix.indices]
    keep = (column >= 0) & np.repeat(target >= 0, np.diff(matrix.indptr))
    until = np.concatenate([[0], np.cumsum(keep, dtype=matrix.indptr.dtype)])[matrix.indptr]
    indptr = np.zeros(width + 1, dtype=matrix.indptr.dtype)
    there = target >= 0
    indptr[1 + target[there]] = np.diff(until)[there]
    entries = (matrix.data[keep], column[keep].astype(matrix.indices.dtype), np.cumsum(indptr))
    return csr_array(entries, shape=(width, width))

"""The pit as a rigid body: all displacements follow from the free nodes' and six pit motions, u = T q."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import block_array, coo_array, csr_array


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
    """The centre of pit rotations: the mean of the pit's nodes."""
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
    """T' K T of a T whose first columns each select one dof, in ascending order; its last ones may not.

    Selected dofs are taken from K by index; only the pit's motions are multiplied.
    """
    column = kinematics.tocsc()
    tied = np.flatnonzero(np.diff(column.indptr) != 1)
    first = int(tied[0]) if len(tied) else kinematics.shape[1]
    if not first:
        return csr_array(kinematics.T @ stiffness @ kinematics)
    picked = column.indices[column.indptr[:first]]
    rows = csr_array(stiffness[picked])
    if first == kinematics.shape[1]:
        return csr_array(rows[:, picked])
    motions = csr_array(kinematics[:, first:])
    mixed, corner = rows @ motions, motions.T @ (stiffness @ motions)
    return csr_array(block_array([[rows[:, picked], mixed], [mixed.T, corner]], format="csr"))

"""The pit as a rigid body that may turn by any angle: x = c + t + R a for a = X - c at rest."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def turned(turn: Float[np.ndarray, "3 3"], step_rad: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """exp(step) R: a further rotation, as a vector in space, on top of the one so far.

    A quarter turn about z takes x to y.

    >>> (turned(np.eye(3), np.array([0, 0, np.pi / 2])) @ [1.0, 0, 0]).round(6)
    array([0., 1., 0.])
    """
    return np.asarray(Rotation.from_rotvec(step_rad).as_matrix() @ turn)


def rigid_fit(
    arm_mm: Float[np.ndarray, "p 3"], displacement_mm: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Shift t and rotation R of the rigid motion nearest to the displacements of a body's points.

    Least squares of |a + u - t - R a|. Source: Kabsch, Acta Crystallographica A 32, 1976.
    """
    mean_arm, mean_displacement = arm_mm.mean(axis=0), displacement_mm.mean(axis=0)
    turn, _ = Rotation.align_vectors(
        arm_mm + displacement_mm - mean_arm - mean_displacement, arm_mm - mean_arm
    )
    matrix = turn.as_matrix()
    return mean_displacement + mean_arm - matrix @ mean_arm, matrix


def resultant(arm_mm: Float[np.ndarray, "p 3"], force_N: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "6"]:
    """Total force (N) and moment (N mm) of forces at the ends of these arms.

    A couple: no force, and a moment of 20 N mm about z.

    >>> resultant(np.array([[10.0, 0, 0], [-10, 0, 0]]), np.array([[0, 1.0, 0], [0, -1, 0]]))
    array([ 0.,  0.,  0.,  0.,  0., 20.])
    """
    return np.concatenate([force_N.sum(axis=0), np.cross(arm_mm, force_N).sum(axis=0)])


def turning_stiffness(
    arm_mm: Float[np.ndarray, "p 3"], force_N: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "3 3"]:
    """What forces f of fixed direction add to the stiffness against rotation (N mm per rad).

    The moment a x f of a force at the end of a changes by (w x a) x f = (a f' - (a . f) I) w; a is the arm in
    its present place and f the force that holds the point. Symmetric where the moments cancel.
    """
    product = arm_mm.T @ force_N
    return np.asarray(product - np.trace(product) * np.eye(3))

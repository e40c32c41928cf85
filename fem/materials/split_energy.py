"""Laws whose energy splits into change of shape and change of volume: W = w(i) + K/2 (J - 1)^2.

i = J^(-2/3) tr(F'F) - 3 measures shape alone, J = det F volume alone; K is the bulk modulus. With
G = F^-T, I1 = tr(F'F) and D = di/dF = 2 J^(-2/3) (F - I1/3 G):

    P = w' D + K (J - 1) J G
    dP_ij/dF_kl = w'' D_ij D_kl + K (2 J - 1) J G_ij G_kl - K (J - 1) J G_il G_kj
                + w' [ - 2/3 D_ij G_kl + 2 J^(-2/3) (delta_ik delta_jl - 2/3 G_ij F_kl + I1/3 G_il G_kj) ]

since dJ/dF = J G and dG_ij/dF_kl = - G_il G_kj. At F = I this is Hooke's law of mu = 2 w'(0) and K.
Source: Holzapfel, "Nonlinear Solid Mechanics", 2000, section 6.4 (decoupled representation).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class ShapeEnergy:
    """J, G = F^-T and i at each point, components first; NaN where J <= 0."""

    F: Float[np.ndarray, "3 3 q"]
    J: Float[np.ndarray, " q"]
    G: Float[np.ndarray, "3 3 q"]
    isochoric: Float[np.ndarray, " q"]

    @classmethod
    def of(cls, F: Float[np.ndarray, "q 3 3"]) -> "ShapeEnergy":
        """From the deformation gradient; quickest where that is a view of components stored one by one."""
        f = np.moveaxis(F, 0, -1)
        cofactor = np.empty(f.shape)
        for i in range(3):
            a, b = f[(i + 1) % 3], f[(i + 2) % 3]
            for j in range(3):
                k, m = (j + 1) % 3, (j + 2) % 3
                cofactor[i, j] = a[k] * b[m] - a[m] * b[k]
        J = (f[0] * cofactor[0]).sum(axis=0)
        J = np.where(J > 0, J, np.nan)
        isochoric = J ** (-2 / 3) * _squares(f) - 3
        return cls(f, J, cofactor / J, isochoric)


def split_stress(
    shape: ShapeEnergy, slope: Float[np.ndarray, " q"] | float, *, bulk: float
) -> Float[np.ndarray, "q 3 3"]:
    """P, from w'(i) = `slope` at each point and the bulk modulus."""
    J, one = shape.J, slope * 2 * shape.J ** (-2 / 3)
    P = one * shape.F + (bulk * (J - 1) * J - one * _squares(shape.F) / 3) * shape.G
    return np.moveaxis(P, -1, 0)


def split_tangent(
    shape: ShapeEnergy,
    slope: Float[np.ndarray, " q"] | float,
    curvature: Float[np.ndarray, " q"] | float,
    *,
    bulk: float,
) -> Float[np.ndarray, "q 3 3 3 3"]:
    """dP/dF, from w'(i) = `slope` and w''(i) = `curvature`."""
    F, G, J = shape.F, shape.G, shape.J
    one, third = slope * 2 * J ** (-2 / 3), _squares(F) / 3
    D = 2 * J ** (-2 / 3) * (F - third * G)
    A = np.einsum("ijq,klq->ijklq", curvature * D - 2 / 3 * slope * G, D)
    with_volume = (bulk * (2 * J - 1) * J - 2 / 3 * third * one) * G - 2 / 3 * slope * D
    A += np.einsum("ijq,klq->ijklq", with_volume, G)
    A += np.einsum("ilq,kjq->ijklq", (one * third - bulk * (J - 1) * J) * G, G)
    for i in range(3):
        for j in range(3):
            A[i, j, i, j] += one
    return np.moveaxis(A, -1, 0)


def _squares(f: Float[np.ndarray, "3 3 q"]) -> Float[np.ndarray, " q"]:
    """I1 = tr(F'F)."""
    return np.asarray((f * f).sum(axis=(0, 1)))

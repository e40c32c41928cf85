"""The compressible Neo-Hookean law of the flesh, in the form of Bonet and Wood.

With J = det F, G = F^-T and Lame's constants mu and lambda:

    W = mu/2 (F : F - 3 - 2 ln J) + lambda/2 (ln J)^2
    P = mu (F - G) + lambda ln(J) G
    dP_ij/dF_kl = mu delta_ik delta_jl + lambda G_ij G_kl + (mu - lambda ln J) G_il G_kj

since dJ/dF = J G and dG_ij/dF_kl = - G_il G_kj. At F = I this is Hooke's law of mu and lambda.
Source: Bonet and Wood, "Nonlinear Continuum Mechanics for Finite Element Analysis", 2008, eq. 6.27 and 6.28.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants


@dataclass(frozen=True, kw_only=True)
class NeoHookean:
    """The law for E = 1 MPa; see the module."""

    poisson_ratio: float

    def stress(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3"]:
        """P = dW/dF, MPa."""
        mu, lam = unit_lame_constants(self.poisson_ratio)
        f, J, G = inverted(F)
        return np.moveaxis(mu * f + (lam * np.log(J) - mu) * G, -1, 0)

    def tangent(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3 3 3"]:
        """dP/dF, MPa."""
        mu, lam = unit_lame_constants(self.poisson_ratio)
        _, J, G = inverted(F)
        A = np.einsum("ijq,klq->ijklq", lam * G, G)
        A += np.einsum("ilq,kjq->ijklq", (mu - lam * np.log(J)) * G, G)
        for i in range(3):
            for j in range(3):
                A[i, j, i, j] += mu
        return np.moveaxis(A, -1, 0)


def inverted(
    F: Float[np.ndarray, "q 3 3"],
) -> tuple[Float[np.ndarray, "3 3 q"], Float[np.ndarray, " q"], Float[np.ndarray, "3 3 q"]]:
    """F, J and G = F^-T at each point, components first; NaN where J <= 0.

    Quickest where F is a view of components stored one by one.
    """
    f = np.moveaxis(F, 0, -1)
    cofactor = np.empty(f.shape)
    for i in range(3):
        a, b = f[(i + 1) % 3], f[(i + 2) % 3]
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            cofactor[i, j] = a[k] * b[m] - a[m] * b[k]
    J = (f[0] * cofactor[0]).sum(axis=0)
    J = np.where(J > 0, J, np.nan)
    return f, J, cofactor / J

"""Hooke's law of small strain, as a law of F: what laws of finite strain are for small loads."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants


@dataclass(frozen=True, kw_only=True)
class Linear:
    """P = lambda tr(e) I + 2 mu e with e = (F + F') / 2 - I.

    A rotation strains it: only for displacement gradients that are small against one.
    """

    poisson_ratio: float

    def stress(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3"]:
        """P, symmetric."""
        mu, lame = unit_lame_constants(self.poisson_ratio)
        strain = (F + F.swapaxes(1, 2)) / 2 - np.eye(3)
        return np.asarray(lame * np.einsum("qii->q", strain)[:, None, None] * np.eye(3) + 2 * mu * strain)

    def tangent(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3 3 3"]:
        """A = lambda I (x) I + mu (delta_ik delta_jl + delta_il delta_jk), the same at every F."""
        mu, lame = unit_lame_constants(self.poisson_ratio)
        unit = np.eye(3)
        shear = np.einsum("ik,jl->ijkl", unit, unit) + np.einsum("il,jk->ijkl", unit, unit)
        hooke = lame * np.einsum("ij,kl->ijkl", unit, unit) + mu * shear
        return np.broadcast_to(hooke, (len(F), 3, 3, 3, 3)).copy()

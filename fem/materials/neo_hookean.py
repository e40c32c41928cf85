"""The compressible Neo-Hookean law: the shear modulus never changes, geometry does all the rest."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.law import unit_shear_and_bulk
from fem.materials.split_energy import ShapeEnergy, split_stress, split_tangent


@dataclass(frozen=True, kw_only=True)
class NeoHookean:
    """W = C10 (J^(-2/3) I1 - 3) + (J - 1)^2 / D1, with C10 = mu/2 and D1 = 2/K.

    The form of *HYPERELASTIC, NEO HOOKE in CalculiX and Abaqus. Source: Dhondt, "CalculiX CrunchiX USER'S
    MANUAL", section on *HYPERELASTIC; Rivlin, Phil. Trans. R. Soc. A 240, 1948, for the part in I1.
    """

    poisson_ratio: float

    def energy(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, " q"]:
        """W, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        shape = ShapeEnergy.of(F)
        return np.asarray(mu / 2 * shape.isochoric + bulk / 2 * (shape.J - 1) ** 2)

    def stress(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3"]:
        """P = dW/dF, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        return split_stress(ShapeEnergy.of(F), mu / 2, bulk=bulk)

    def tangent(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3 3 3"]:
        """dP/dF, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        return split_tangent(ShapeEnergy.of(F), mu / 2, 0.0, bulk=bulk)

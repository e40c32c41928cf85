"""Fung's exponential law in Demiray's isotropic form: cells that stretch, then hold."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.law import unit_shear_and_bulk
from fem.materials.split_energy import ShapeEnergy, split_stress, split_tangent


@dataclass(frozen=True, kw_only=True)
class Fung:
    """W = mu/(2 b) [exp(b i) - 1] + K/2 (J - 1)^2 with i = J^(-2/3) I1 - 3 and b = `stiffening` > 0.

    As b goes to zero this is the Neo-Hookean law; b is not felt at small strain.
    Source: Demiray, Journal of Biomechanics 5, 1972, pp. 309-311.
    """

    poisson_ratio: float
    stiffening: float

    def energy(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, " q"]:
        """W, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        shape = ShapeEnergy.of(F)
        b = self.stiffening
        return np.asarray(mu / 2 * np.expm1(b * shape.isochoric) / b + bulk / 2 * (shape.J - 1) ** 2)

    def stress(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3"]:
        """P = dW/dF, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        shape = ShapeEnergy.of(F)
        return split_stress(shape, mu / 2 * np.exp(self.stiffening * shape.isochoric), bulk=bulk)

    def tangent(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3 3 3"]:
        """dP/dF, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        shape = ShapeEnergy.of(F)
        slope = mu / 2 * np.exp(self.stiffening * shape.isochoric)
        return split_tangent(shape, slope, self.stiffening * slope, bulk=bulk)

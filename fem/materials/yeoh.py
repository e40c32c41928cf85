"""Yeoh's law: a polynomial in the change of shape, soft first and stiffer as it grows."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.law import unit_shear_and_bulk
from fem.materials.split_energy import ShapeEnergy, split_stress, split_tangent


@dataclass(frozen=True, kw_only=True)
class Yeoh:
    """W = mu/2 (i + second i^2 + third i^3) + K/2 (J - 1)^2 with i = J^(-2/3) I1 - 3.

    `second` = C20/C10 and `third` = C30/C10, without dimension; both zero is the Neo-Hookean law, and neither
    is felt at small strain. Source: Yeoh, Rubber Chemistry and Technology 66, 1993, pp. 754-771.
    """

    poisson_ratio: float
    second: float
    third: float

    def energy(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, " q"]:
        """W, MPa."""
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        shape = ShapeEnergy.of(F)
        i = shape.isochoric
        return np.asarray(
            mu / 2 * i * (1 + self.second * i + self.third * i**2) + bulk / 2 * (shape.J - 1) ** 2
        )

    def stress(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3"]:
        """P = dW/dF, MPa."""
        shape, slope, _, bulk = self._at(F)
        return split_stress(shape, slope, bulk=bulk)

    def tangent(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3 3 3"]:
        """dP/dF, MPa."""
        shape, slope, curvature, bulk = self._at(F)
        return split_tangent(shape, slope, curvature, bulk=bulk)

    def _at(
        self, F: Float[np.ndarray, "q 3 3"]
    ) -> tuple[ShapeEnergy, Float[np.ndarray, " q"], Float[np.ndarray, " q"], float]:
        mu, bulk = unit_shear_and_bulk(self.poisson_ratio)
        shape = ShapeEnergy.of(F)
        i = shape.isochoric
        slope = mu / 2 * (1 + 2 * self.second * i + 3 * self.third * i**2)
        return shape, slope, mu / 2 * (2 * self.second + 6 * self.third * i), bulk

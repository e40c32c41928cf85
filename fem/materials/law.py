"""What every material law offers, and the constants that small strains share with Hooke's law."""

from typing import Protocol

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants


class UnitLaw(Protocol):
    """An elastic law for E = 1 MPa; every stress of the real flesh is E (in MPa) times this one's.

    F = dx/dX is the deformation gradient at each of q points. Where det F <= 0, the laws of finite strain
    answer NaN: no matter can be there.
    """

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio at small strain."""
        ...

    def stress(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3"]:
        """First Piola stress P = dW/dF, MPa: force per area at rest."""
        ...

    def tangent(self, F: Float[np.ndarray, "q 3 3"]) -> Float[np.ndarray, "q 3 3 3 3"]:
        """Consistent tangent A_ijkl = dP_ij/dF_kl, MPa."""
        ...


def unit_shear_and_bulk(poisson_ratio: float) -> tuple[float, float]:
    """Shear modulus 1 / (2 (1 + nu)) and bulk modulus 1 / (3 (1 - 2 nu)) for E = 1 MPa.

    Raises BAD_POISSON_RATIO outside 0 to 0.4999.

    >>> unit_shear_and_bulk(0.25)
    (0.4, 0.6666666666666667)
    """
    mu, lame = unit_lame_constants(poisson_ratio)
    return mu, lame + 2 / 3 * mu

"""What every material law offers."""

from typing import Protocol

import numpy as np
from jaxtyping import Float


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

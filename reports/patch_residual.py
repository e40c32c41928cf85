"""What a fruit's own recordings leave unexplained at a pad's markers: numbers, before anything is drawn."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True, eq=False)
class PatchResidual:
    """Markers of a pad in a grasp: their places on the skin (fruit frame, mm) and residuals (um).

    Positive: the recorded skin went farther in than the model's.
    """

    name: str
    places_mm: Float[np.ndarray, "k 3"]
    residual_um: Float[np.ndarray, " k"]

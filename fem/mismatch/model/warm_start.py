"""Warm starts: a search starts from the nearest of the solutions that the same search has found before.

A search of parameters (fem.mismatch.selection.refinement) solves the same model again and again for
parameters that differ little; the solutions of one belong to it alone. A call without a search's warm
starts begins from nothing, so that it gives the same answer whatever was asked before.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

MOST = 6
"""Solutions kept of each model: one may be a field of all frames."""


@dataclass(frozen=True)
class WarmStarts:
    """What one search has found, each under the key of the model that found it, with the parameters (in units
    of distance) that it is for. Values are never changed.
    """

    solutions: dict[object, tuple[tuple[Float[np.ndarray, " p"], Any], ...]] = field(default_factory=dict)

    def nearest(
        self, key: object, place: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, " p"], Any] | None:
        """The place of the nearest solution, and the solution; None where there is none."""
        known = self.solutions.get(key, ())
        return min(known, key=lambda pair: float(np.linalg.norm(pair[0] - place)), default=None)

    def keep(self, key: object, place: Float[np.ndarray, " p"], solution: object) -> None:
        """Keeps one more solution; the oldest of MOST is dropped."""
        self.solutions[key] = ((place, solution), *self.solutions.get(key, ()))[:MOST]

    def copy(self) -> "WarmStarts":
        """A copy for another search that continues from here on its own."""
        return WarmStarts(dict(self.solutions))

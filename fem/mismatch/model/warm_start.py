"""Warm starts: an iteration starts from the nearest solution that the same search has found before.

A search of parameters (fem.mismatch.selection.refinement) solves the same model repeatedly for slightly
different parameters. Each search keeps its own solutions. A call without a search's warm starts begins from
zero, so that its result does not depend on earlier calls.

For a response that is expensive to compute, solutions are anchors of a second-order surrogate, exact there:

    c(theta) = c0 + J theta + k^2 (c(theta_a) - c0 - J theta_a),      k = theta . theta_a / |theta_a|^2

J is the first-order change, theta_a the nearest anchor, in units of the parameters' spreads. If theta is
farther from every anchor than `far` times its norm, it becomes an anchor.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

MOST = 6
"""Solutions kept for each model: one may be a field of all frames."""


@dataclass(frozen=True)
class WarmStarts:
    """Solutions of one search by the key of their model, each with its parameters (in units of distance).
    Values are never changed.
    """

    solutions: dict[object, tuple[tuple[Float[np.ndarray, " p"], Any], ...]] = field(default_factory=dict)

    def nearest(
        self, key: object, place: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, " p"], Any] | None:
        """The parameters of the nearest solution, and the solution; None if there is none."""
        known = self.solutions.get(key, ())
        return min(known, key=lambda pair: float(np.linalg.norm(pair[0] - place)), default=None)

    def keep(self, key: object, place: Float[np.ndarray, " p"], solution: object) -> None:
        """Keeps one more solution; drops the oldest beyond MOST."""
        self.solutions[key] = ((place, solution), *self.solutions.get(key, ()))[:MOST]

    def copy(self) -> "WarmStarts":
        """A copy for another search that continues from here on its own."""
        return WarmStarts(dict(self.solutions))


NEAR, FAR = 0.1, 0.4
"""Norm of theta, in spreads, below which J theta alone is used; default of `far`."""
Quantities = list[list[np.ndarray]]
"""For each recording."""


def quadratic_surrogate(
    starts: WarmStarts | None,
    key: object,
    theta: Float[np.ndarray, " p"],
    *,
    first_order: Callable[[Float[np.ndarray, " p"]], Quantities],
    exact: Callable[[Float[np.ndarray, " p"]], Quantities],
    far: float = FAR,
) -> Quantities:
    """The quantities at theta (in spreads); `exact` is called if no anchor of `starts` is near."""
    linear, size = first_order(theta), float(np.linalg.norm(theta))
    if size < NEAR:
        return linear
    known = None if starts is None else starts.nearest(key, theta)
    if known is None or np.linalg.norm(theta - known[0]) > far * size:
        pairs = zip(exact(theta), linear, strict=True)
        known = theta, [[a - b for a, b in zip(x, y, strict=True)] for x, y in pairs]
        if starts is not None:
            starts.keep(key, *known)
    anchor, excess = known
    share = float(theta @ anchor / max(anchor @ anchor, 1e-12)) ** 2
    return [
        [q + share * more for q, more in zip(quantities, beyond, strict=True)]
        for quantities, beyond in zip(linear, excess, strict=True)
    ]

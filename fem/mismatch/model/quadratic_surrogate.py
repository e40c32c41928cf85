"""A second-order surrogate of a response that is expensive to compute: exact where it was computed.

    c(theta) = c0 + J theta + k^2 (c(theta_a) - c0 - J theta_a),      k = theta . theta_a / |theta_a|^2

J is the first-order change, theta_a the nearest anchor, in units of the parameters' spreads: where theta is
farther from all of them than `far` of its own size it becomes one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.forward_model import ForwardModel

NEAR, FAR = 0.1, 0.4
"""Parameters this near to none, in units of the spreads, add nothing to J."""


@dataclass(frozen=True)
class SurrogateAnchor:
    """`anchor` and, for each recording and quantity, the excess over first order there."""

    anchor: Float[np.ndarray, " p"]
    excess: list[list[np.ndarray]]

    def share(self, theta: Float[np.ndarray, " p"]) -> float:
        """k^2."""
        return float((theta @ self.anchor / max(self.anchor @ self.anchor, 1e-12)) ** 2)


def quadratic_surrogate(
    forward: ForwardModel,
    key: object,
    theta: Float[np.ndarray, " p"],
    *,
    first_order: Callable[[Float[np.ndarray, " p"]], Sequence[Sequence[np.ndarray]]],
    exact: Callable[[Float[np.ndarray, " p"]], Sequence[Sequence[np.ndarray]]],
    far: float = FAR,
) -> list[list[np.ndarray]]:
    """The quantities at theta (in spreads); `exact` is called where no anchor of the search lies near."""
    known: tuple[SurrogateAnchor, ...] = forward.warm_start(("anchored", key))
    size = float(np.linalg.norm(theta))
    if size < NEAR:
        return [list(quantities) for quantities in first_order(theta)]
    nearest = min(known, key=lambda anchor: float(np.linalg.norm(theta - anchor.anchor)), default=None)
    if nearest is None or np.linalg.norm(theta - nearest.anchor) > far * size:
        pairs = zip(exact(theta), first_order(theta), strict=True)
        nearest = SurrogateAnchor(theta, [[a - b for a, b in zip(x, y, strict=True)] for x, y in pairs])
        forward.store_warm_start(("anchored", key), (*known, nearest))
    share = nearest.share(theta)
    return [
        [q + share * more for q, more in zip(quantities, excess, strict=True)]
        for quantities, excess in zip(first_order(theta), nearest.excess, strict=True)
    ]

"""A second-order surrogate of a response that is expensive to compute: exact where it was computed.

    c(theta) = c0 + J theta + k^2 (c(theta_a) - c0 - J theta_a),      k = theta . theta_a / |theta_a|^2

J is the first-order change, theta_a the nearest anchor, in units of the parameters' spreads: where theta is
farther from all of them than `far` of its own size it becomes one.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.warm_start import WarmStarts

NEAR, FAR = 0.1, 0.4
"""Parameters this near to none, in units of the spreads, add nothing to J."""
Quantities = list[list[np.ndarray]]
"""Of each recording."""


def quadratic_surrogate(
    starts: WarmStarts | None,
    key: object,
    theta: Float[np.ndarray, " p"],
    *,
    first_order: Callable[[Float[np.ndarray, " p"]], Quantities],
    exact: Callable[[Float[np.ndarray, " p"]], Quantities],
    far: float = FAR,
) -> Quantities:
    """The quantities at theta (in spreads); `exact` is called where no anchor of `starts` lies near."""
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

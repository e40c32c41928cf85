"""Anderson mixing of the rounds of a search, the samples' own: the truth must not use the estimator's code.

Source: Walker and Ni, SIAM Journal on Numerical Analysis 49, 2011 (type II).
"""

import numpy as np
from jaxtyping import Float


class AndersonMixing:
    """The last `depth` rounds and their mix."""

    def __init__(self, depth: int) -> None:
        self._depth = depth
        self._mapped: list[np.ndarray] = []
        self._change: list[np.ndarray] = []

    def mixed(self, q: Float[np.ndarray, " u"], mapped: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
        """The next guess, where `mapped` is what a round has made of the guess q."""
        self._mapped = [*self._mapped[-self._depth :], mapped]
        self._change = [*self._change[-self._depth :], mapped - q]
        if len(self._change) == 1:
            return mapped
        steps = np.stack([b - a for a, b in zip(self._change[:-1], self._change[1:], strict=True)], axis=1)
        moves = np.stack([b - a for a, b in zip(self._mapped[:-1], self._mapped[1:], strict=True)], axis=1)
        share, *_ = np.linalg.lstsq(steps, self._change[-1], rcond=1e-10)
        return np.asarray(mapped - moves @ share)

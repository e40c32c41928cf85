"""Anderson's acceleration of an iteration  x <- x + f(x)  that goes on until f(x) = 0.

    x_k+1 = x_k + f_k - sum_j g_j (dx_j + df_j),      g = argmin |f_k - sum_j g_j df_j|

dx_j and df_j: changes of x and f in each of the last steps. In a linear problem this is GMRES followed by one
plain step; with a single unknown it is the secant method.
Source: Anderson, "Iterative procedures for nonlinear integral equations", Journal of the ACM 12, 1965; in
this form (type II) Walker and Ni, "Anderson acceleration for fixed-point iterations", SIAM Journal on
Numerical Analysis 49, 2011, section 2.
"""

from collections import deque
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Step = Float[np.ndarray, "..."]
_Change = tuple[Float[np.ndarray, " g"], Float[np.ndarray, "g n"], Step]
"""Norm and direction of a change of f in each group, and the change of x + f(x)."""

RESOLVED = 1e-4
"""Share of a change df_j that counts as information: a smaller part independent of the other changes may be
rounding, mostly of stresses in single precision (fem.solid.flesh_pieces). The least squares take every change
at unit size, damped by the square of this (Tikhonov). From 1e-3 to 1e-7 the numbers of steps are the same."""


def as_one(step: Step) -> Float[np.ndarray, "1 n"]:
    """A step as one group with equal weights."""
    return step.reshape(1, -1)


class Anderson:
    """The changes in the last steps, and the next step that follows from them.

    `memory`: how many changes are kept. `weighed`: from a step to the numbers that are minimised, (groups,
    numbers); each group has a mix of its own. Groups are the first axis of a step, or there is one group.
    """

    def __init__(self, memory: int, *, weighed: Callable[[Step], Float[np.ndarray, "g n"]] = as_one) -> None:
        self._weighed = weighed
        self._past: deque[_Change] = deque(maxlen=memory)
        self._plain: Step | None = None
        self._taken: Step | None = None

    def step(self, plain: Step) -> Step:
        """The step to take in place of f(x) = `plain`; call `took` if it was taken, else `forget`."""
        if self._plain is not None and self._taken is not None:
            change = self._weighed(plain) - self._weighed(self._plain)
            size = np.maximum(np.linalg.norm(change, axis=1), np.finfo(float).tiny)
            self._past.append((size, change / size[:, None], plain - self._plain + self._taken))
        self._plain, self._taken = plain, None
        if not self._past:
            return plain
        sizes, changes, moves = zip(*self._past, strict=True)
        unit = np.stack(changes, axis=1)
        gram = unit @ np.swapaxes(unit, 1, 2) + RESOLVED**2 * np.eye(len(moves))
        mix = np.linalg.solve(gram, unit @ self._weighed(plain)[..., None])[..., 0] / np.stack(sizes, axis=1)
        step = plain.copy()
        for g, move in zip(mix.T, moves, strict=True):
            step -= g.reshape(-1, *[1] * (plain.ndim - 1)) * move
        return step

    def took(self, step: Step) -> None:
        """Records that the last step was taken in full, as `step`."""
        self._taken = step

    def forget(self) -> None:
        """Discards all steps: one was cut short, or f changed."""
        self._past.clear()
        self._plain = self._taken = None

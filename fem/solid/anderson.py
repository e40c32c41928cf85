"""Anderson's acceleration of an iteration  x <- x + f(x)  that goes on until f(x) = 0.

    x_k+1 = x_k + f_k - sum_j g_j (dx_j + df_j),      g = argmin |f_k - sum_j g_j df_j|

dx_j and df_j: by how much x and f changed in each of the last steps. In a linear problem this is GMRES, one
plain step further on; with a single unknown it is the secant method.
Source: Anderson, "Iterative procedures for nonlinear integral equations", Journal of the ACM 12, 1965; in
this form (type II) Walker and Ni, "Anderson acceleration for fixed-point iterations", SIAM Journal on
Numerical Analysis 49, 2011, section 2.
"""

from collections import deque
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Step = Float[np.ndarray, "..."]

RESOLVED = 1e-4
"""Share of a change df_j that counts as learnt: what the other changes leave of it, if less, may be rounding,
of which stresses in single precision (fem.solid.flesh_pieces) make most. The least squares take every change
at unit size, damped by the square of this (Tikhonov). From 1e-3 to 1e-7 the numbers of steps
are the same."""


def as_one(step: Step) -> Float[np.ndarray, "1 n"]:
    """All of a step weighed alike, in one group."""
    return step.reshape(1, -1)


class Anderson:
    """What the last steps have taught, and the step that follows from it.

    `memory`: how many changes are kept. `weighed`: of a step, the numbers that are to become least, (groups,
    numbers); each group has a mix of its own. Groups are the first axis of a step, or there is one group.
    """

    def __init__(self, memory: int, *, weighed: Callable[[Step], Float[np.ndarray, "g n"]] = as_one) -> None:
        self._weighed = weighed
        self._size: deque[Float[np.ndarray, " g"]] = deque(maxlen=memory)
        self._change: deque[Float[np.ndarray, "g n"]] = deque(maxlen=memory)
        self._move: deque[Step] = deque(maxlen=memory)
        self._plain: Step | None = None
        self._taken: Step | None = None

    def __len__(self) -> int:
        """How many changes the next step is mixed from."""
        return len(self._move)

    def step(self, plain: Step) -> Step:
        """The step to take in the place of f(x) = `plain`; say with `took` that it was taken, or `forget`."""
        if self._plain is not None and self._taken is not None:
            change = self._weighed(plain) - self._weighed(self._plain)
            size = np.maximum(np.linalg.norm(change, axis=1), np.finfo(float).tiny)
            self._size.append(size)
            self._change.append(change / size[:, None])
            self._move.append(plain - self._plain + self._taken)
        self._plain, self._taken = plain, None
        if not self._move:
            return plain
        unit = np.stack(self._change, axis=1)
        gram = unit @ np.swapaxes(unit, 1, 2) + RESOLVED**2 * np.eye(len(self))
        mix = np.linalg.solve(gram, unit @ self._weighed(plain)[..., None])[..., 0] / np.stack(
            self._size, axis=1
        )
        step = plain.copy()
        for g, move in zip(mix.T, self._move, strict=True):
            step -= g.reshape(-1, *[1] * (plain.ndim - 1)) * move
        return step

    def took(self, step: Step) -> None:
        """The step last asked for was taken, in full and like this."""
        self._taken = step

    def forget(self) -> None:
        """Begin anew: a step was cut short, or f is another."""
        self._size.clear()
        self._change.clear()
        self._move.clear()
        self._plain = self._taken = None

"""Flesh of another linear law, in the space of what the plain one does and its first corrections.

K(theta) = sum_i a_i(theta) K_i is projected (Galerkin) on

    V = [U, K0^-1 D U, (K0^-1 D)^2 U, (K0^-1 D)^3 U],      D = dK/dtheta

for the patterns U of a recording. Its answer agrees with the full one to the seventh power of theta in the
work done on the loads (moment matching: Antoulas 2005, Approximation of Large-Scale Dynamical Systems,
chapter 11), and costs nothing once V is there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.baseline import Seen
from fem.mismatch.ground import Ground

CORRECTIONS = 3
Operator = Callable[[Float[np.ndarray, "f m 3"]], Float[np.ndarray, "f m 3"]]
"""K_i: from displacements to the forces that they cost, for E = 1 MPa."""


@dataclass(frozen=True)
class ReducedLaw:
    """One recording. `parts`: V' K_i V; `load`: V' f; `seen`: the markers' displacement in each of V."""

    parts: Float[np.ndarray, "i q q"]
    load: Float[np.ndarray, "q r"]
    seen: Float[np.ndarray, "q n 3"]
    shares: Float[np.ndarray, "f r"]
    first: Float[np.ndarray, "f n 3"]

    def response(self, amounts: Sequence[float]) -> Float[np.ndarray, "f n 3"]:
        """c(t) where the law is sum_i amounts_i K_i, mm MPa."""
        stiffness = np.tensordot(np.asarray(amounts, dtype=float), self.parts, axes=(0, 0))
        size = np.sqrt(np.diag(self.parts[0]))
        scaled = stiffness / np.outer(size, size)
        moved = np.linalg.lstsq(scaled, self.load / size[:, None], rcond=1e-10)[0] / size[:, None]
        return np.asarray(np.tensordot(self.shares @ moved.T, self.seen, axes=(1, 0)))


def reduced_law(ground: Ground, seen: Seen, *, derivative: Operator, parts: Sequence[Operator]) -> ReducedLaw:
    """The reduced law; the first of `parts` is positive on every strain (it sets the scale)."""
    solid = ground.base.solid_of(seen)
    steps = [seen.moved]
    for _ in range(CORRECTIONS):
        steps.append(-solid.displacement(derivative(steps[-1])))
    space = np.concatenate(steps)
    flat = space.reshape(len(space), -1)
    projected = []
    for part in parts:
        own = flat @ part(space).reshape(len(space), -1).T
        projected.append((own + own.T) / 2)
    skin = solid.contact_nodes
    load = flat @ (solid.stiffness @ seen.moved.reshape(len(seen.moved), -1).T)
    at_markers = seen.at_markers(space[:, skin])
    count = len(seen.moved)
    return ReducedLaw(
        np.stack(projected), load, at_markers, seen.shares, seen.over_time(at_markers[count : 2 * count])
    )

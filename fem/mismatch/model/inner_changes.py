"""How a recording's response changes with what is inside the fruit and with its surface, to first order."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import inner_forces
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.force_products import ForceNoise
from fem.mismatch.model.forward_model import ForwardModel

LEADING = 4
"""Force patterns whose response is followed: the others are hundredths of the first."""


def inner_changes(forward: ForwardModel, recording: GraspResponse) -> dict[str, Float[np.ndarray, "f n 3"]]:
    """dc/dp, mm MPa, for what moves no pad in fem.estimation.sensitivity: pit, surface, Poisson's ratio."""

    def compute() -> dict[str, Float[np.ndarray, "f n 3"]]:
        chosen = recording.moved[:LEADING]
        causes, forces = inner_forces(forward.base.solid_of(recording), chosen, list(recording.links))
        moved = forward.base.marker_response(recording, forces.reshape(-1, *forces.shape[2:]))
        moved = moved.reshape(len(causes), len(chosen), *moved.shape[1:])
        shares = recording.shares[:, :LEADING]
        return {
            cause: np.asarray(np.tensordot(shares, pattern_changes, axes=(1, 0)))
            for cause, pattern_changes in zip(causes, moved, strict=True)
        }

    return forward.memoised(("inner", recording.case.name), compute)


@dataclass(frozen=True)
class OfInnerChange:
    """How s dc/dp of a cause inside the fruit follows from forces (fem.mismatch.model.force_products)."""

    cause: str

    def product(self, noise: ForceNoise) -> float:
        """n of the cause; zero where the fruit has no such one."""
        return noise.compliance * noise.inner_products.get(self.cause, 0.0)

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """One solve for each draw and pattern; zero where the fruit has no such cause."""
        draws, patterns, nodes = len(noise.moved), noise.recording.finer.first, noise.moved.shape[2]
        moved = noise.moved[:, :patterns].reshape(draws * patterns, nodes, 3)
        causes, loads = inner_forces(noise.solid, moved, list(noise.recording.links), with_surface=False)
        if self.cause not in causes:
            return np.zeros_like(noise.weighed)
        return noise.solved(loads[list(causes).index(self.cause)].reshape(draws, patterns, nodes, 3))

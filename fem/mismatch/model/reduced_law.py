"""Flesh under another linear law, reduced to the span of the plain law's response and its first corrections.

K(theta) = sum_i a_i(theta) K_i is projected (Galerkin) on

    V = [U, K0^-1 D U, (K0^-1 D)^2 U, (K0^-1 D)^3 U],      D = dK/dtheta

for the patterns U of a recording. The work of the loads agrees with that of the full model to the seventh
power of theta (moment matching: Antoulas 2005, Approximation of Large-Scale Dynamical Systems, chapter 11).
No solve of the full system is needed. The response to the finer patterns of a recording's forces
(fem.estimation.finer_patterns), hundredths of the whole, remains that of the plain law.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields, GraspResponse

CORRECTIONS = 3
"""Highest power of K0^-1 D in V; tests compare reduced and full responses for three
(tests/fem/test_mismatch_flesh_laws.py)."""
Operator = Callable[[Float[np.ndarray, "f m 3"]], Float[np.ndarray, "f m 3"]]
"""K_i: from displacements to their nodal forces, for E = 1 MPa."""


@dataclass(frozen=True)
class ReducedLaw:
    """One recording. `parts`: V' K_i V; `load`: V' f; `recording`: the markers' displacement for each vector
    of V; `unchanged`: the finer patterns' response.
    """

    parts: Float[np.ndarray, "i q q"]
    load: Float[np.ndarray, "q r"]
    recording: Float[np.ndarray, "q n 3"]
    shares: Float[np.ndarray, "f r"]
    unchanged: Float[np.ndarray, "f n 3"]

    def response(self, amounts: Sequence[float]) -> Float[np.ndarray, "f n 3"]:
        """c(t) where the law is sum_i amounts_i K_i, mm MPa."""
        stiffness = np.tensordot(np.asarray(amounts, dtype=float), self.parts, axes=(0, 0))
        size = np.sqrt(np.maximum(np.diag(self.parts[0]), np.finfo(float).tiny))
        scaled = stiffness / np.outer(size, size)
        moved = np.linalg.lstsq(scaled, self.load / size[:, None], rcond=1e-10)[0] / size[:, None]
        return np.asarray(np.tensordot(self.shares @ moved.T, self.recording, axes=(1, 0)) + self.unchanged)


def first_changes(model: CaseModel, derivative: Operator) -> Fields:
    """dc/dtheta of every recording at the plain law, mm MPa: -K0^-1 D U at the markers."""
    grasps = model.grasps
    cuts = np.cumsum([len(recording.leading) for recording in grasps])[:-1]
    patterns = np.concatenate([recording.moved[recording.leading] for recording in grasps])
    moved = model.base.displacements(np.split(-derivative(patterns), cuts))
    return [
        np.tensordot(
            recording.shares[:, recording.leading],
            recording.at_markers(displacement),
            axes=1,
        )
        for recording, displacement in zip(grasps, moved, strict=True)
    ]


def reduced_laws(
    model: CaseModel,
    *,
    derivative: Operator,
    parts: Sequence[Operator],
    corrections: int = CORRECTIONS,
) -> list[ReducedLaw]:
    """One for each recording; the first of `parts` is positive for every strain (it sets the scale)."""
    grasps = model.grasps
    first = np.cumsum([0, *(len(recording.leading) for recording in grasps)])
    steps = [np.concatenate([recording.moved[recording.leading] for recording in grasps])]
    for _ in range(corrections):
        cost = np.split(derivative(steps[-1]), first[1:-1])
        steps.append(-np.concatenate(model.base.displacements(cost)))
    pulled = [[part(step) for step in steps] for part in parts]
    return [
        _of_recording(
            recording,
            np.concatenate([step[a:b] for step in steps]),
            [np.concatenate([step[a:b] for step in part_forces]) for part_forces in pulled],
        )
        for recording, a, b in zip(grasps, first, first[1:], strict=False)
    ]


def _of_recording(
    recording: GraspResponse,
    space: Float[np.ndarray, "q m 3"],
    pulled: Sequence[np.ndarray],
) -> ReducedLaw:
    """`pulled`: nodal forces by each part's law for each field of `space`."""
    solid, leading = recording.solid, recording.leading
    count = len(leading)
    flat = space.reshape(len(space), -1)
    projected = []
    for force in pulled:
        product = flat @ force.reshape(len(space), -1).T
        projected.append((product + product.T) / 2)
    load = flat @ (solid.stiffness @ recording.moved[leading].reshape(count, -1).T)
    at_markers = recording.at_markers(space)
    return ReducedLaw(
        np.stack(projected),
        load,
        at_markers,
        recording.shares[:, leading],
        recording.tracks.unit_displacement
        - np.tensordot(recording.shares[:, leading], recording.response[leading], axes=1),
    )

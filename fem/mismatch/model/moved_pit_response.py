"""Responses with the pit elsewhere or of another size: the mesh moved, factorised and solved again."""

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import inner_changes
from fem.mismatch.model.quadratic_surrogate import quadratic_surrogate
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved

SPREAD = np.array([1.0, 1.0, 1.0, 0.15])
"""Units in which pits are far or near: mm, mm, mm, ln size."""


def pit_responses(
    forward: ForwardModel, key: str, pit: Float[np.ndarray, "4"]
) -> list[Float[np.ndarray, "_f _n 3"]]:
    """c(t) of every recording, the pit moved by x, y, z (mm) and scaled by exp of the fourth.

    Raises FemFailure where the pit would leave the flesh.
    """
    grasps = forward.base.grasps

    def first_order(theta: Float[np.ndarray, "4"]) -> list[list[np.ndarray]]:
        responses = []
        for recording in grasps:
            change = inner_changes(forward, recording)
            change_of_unit = sum(x * change[name] for x, name in zip(theta * SPREAD, PIT, strict=True))
            responses.append([recording.tracks.unit_displacement + change_of_unit])
        return responses

    def exact(theta: Float[np.ndarray, "4"]) -> list[list[np.ndarray]]:
        mesh = with_pit_moved(forward.base.mesh, theta * SPREAD)
        solids = {
            support: UnitModulusSolid.factorise(mesh, poisson_ratio=forward.poisson_ratio, support=support)
            for support in forward.base.solids
        }

        def moved_under(recording: GraspResponse) -> list[np.ndarray]:
            skin = forward.base.solid_of(recording).contact_nodes
            loads = np.zeros((len(recording.patterns), len(mesh.nodes_mm), 3))
            loads[:, skin] = recording.nodal_of(recording.patterns)
            moved = solids[recording.case.support].displacement(loads)[:, skin]
            return [recording.over_time(recording.at_markers(moved))]

        return forward.each(moved_under)

    return [
        quantities[0]
        for quantities in quadratic_surrogate(
            forward, key, pit / SPREAD, first_order=first_order, exact=exact
        )
    ]

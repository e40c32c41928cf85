"""Responses with the pit elsewhere or of another size: the mesh moved, factorised and solved again."""

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import inner_changes
from fem.mismatch.model.quadratic_surrogate import anchored
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved

SPREAD = np.array([1.0, 1.0, 1.0, 0.15])
"""Units in which pits are far or near: mm, mm, mm, ln size."""


def pit_responses(
    ground: ForwardModel, key: str, pit: Float[np.ndarray, "4"]
) -> list[Float[np.ndarray, "f n 3"]]:
    """c(t) of every recording, the pit moved by x, y, z (mm) and scaled by exp of the fourth.

    Raises FemFailure where the pit would leave the flesh.
    """
    grasps = ground.base.grasps

    def first_order(theta: Float[np.ndarray, "4"]) -> list[list[np.ndarray]]:
        found = []
        for seen in grasps:
            change = inner_changes(ground, seen)
            own = sum(x * change[name] for x, name in zip(theta * SPREAD, PIT, strict=True))
            found.append([seen.tracks.unit_displacement + own])
        return found

    def exact(theta: Float[np.ndarray, "4"]) -> list[list[np.ndarray]]:
        mesh = with_pit_moved(ground.base.mesh, theta * SPREAD)
        solids = {
            support: UnitModulusSolid.factorise(mesh, poisson_ratio=ground.poisson_ratio, support=support)
            for support in ground.base.solids
        }

        def moved_under(seen: GraspResponse) -> list[np.ndarray]:
            skin = ground.base.solid_of(seen).contact_nodes
            loads = np.zeros((len(seen.patterns), len(mesh.nodes_mm), 3))
            loads[:, skin] = seen.nodal_of(seen.patterns)
            moved = solids[seen.case.support].displacement(loads)[:, skin]
            return [seen.over_time(seen.at_markers(moved))]

        return ground.each(moved_under)

    return [own[0] for own in anchored(ground, key, pit / SPREAD, first_order=first_order, exact=exact)]

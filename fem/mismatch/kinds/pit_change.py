"""An effect that has the pit elsewhere or of another size: the mesh moved, factorised and solved again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT
from fem.mismatch.effect import Response, Signature
from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import OfInnerChange, inner_changes
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.quadratic_surrogate import Quantities, quadratic_surrogate
from fem.mismatch.signature_variant import ONE_WAY, Variant
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved

SPREAD = np.array([1.0, 1.0, 1.0, 0.15])
"""Units in which pits are far or near: mm, mm, mm, ln size."""


@dataclass(frozen=True, kw_only=True)
class PitChange:
    """`causes`: of fem.estimation.sensitivity, one for each parameter; `sd`: their prior standard deviation.
    `value`: a parameter from its cause's amount, `amount` the other way round.
    """

    spec: EffectSpec
    causes: tuple[str, ...]
    sd: float
    value: Callable[[float], float] = float
    amount: Callable[[float], float] = float

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """The first order; none for a fruit without a pit."""
        if not len(forward.base.mesh.pit_nodes):
            return []
        changes = [inner_changes(forward, recording) for recording in forward.base.grasps]
        columns = tuple(
            Regressor(
                name=cause,
                sd=self.sd,
                fields=[ObservationDelta(markers=forward.compliance * change[cause]) for change in changes],
                of_forces=OfInnerChange(cause),
            )
            for cause in self.causes
        )
        return [Signature(variant=ONE_WAY, columns=columns)]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The pit of these amounts."""
        return self.spec.within_bounds(*(self.value(amount) for amount in amounts))

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The fruit meshed with that pit. Raises FemFailure where the pit would leave the flesh."""
        pit = np.zeros(len(PIT))
        for cause, spec in zip(self.causes, self.spec.searched, strict=True):
            pit[PIT.index(cause)] = self.amount(parameters[spec.name])
        quantities = quadratic_surrogate(
            forward.warm_starts,
            self.spec.name,
            pit / SPREAD,
            first_order=partial(_first_order, forward),
            exact=partial(_exact, forward),
        )
        return Response(unit=[unit for (unit,) in quantities])


def _first_order(forward: ForwardModel, theta: Float[np.ndarray, "4"]) -> Quantities:
    responses = []
    for recording in forward.base.grasps:
        change = inner_changes(forward, recording)
        more = sum(x * change[name] for x, name in zip(theta * SPREAD, PIT, strict=True))
        responses.append([recording.tracks.unit_displacement + more])
    return responses


def _exact(forward: ForwardModel, theta: Float[np.ndarray, "4"]) -> Quantities:
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

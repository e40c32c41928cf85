"""Effects that move or scale the pit: the mesh is moved, factorised and solved again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.force_noise import OfInnerChange
from fem.mismatch.model.inner_changes import inner_changes
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.model.warm_start import Quantities, quadratic_surrogate
from fem.mismatch.signature_variant import ONE_WAY, Variant
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved

SPREAD = np.array([1.0, 1.0, 1.0, 0.15])
"""Units of the distance between pits: mm, mm, mm, ln size."""


@dataclass(frozen=True, kw_only=True)
class PitChange(Effect):
    """`causes`: causes of fem.estimation.sensitivity, one for each parameter; `sd`: their prior standard
    deviation. `value` converts a cause's amount to its parameter, `amount` the reverse.
    """

    causes: tuple[str, ...]
    sd: float
    value: Callable[[float], float] = float
    amount: Callable[[float], float] = float

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """The first-order change; none for a fruit without a pit."""
        if not len(model.mesh.pit_nodes):
            return []
        changes = [inner_changes(model, recording) for recording in model.grasps]
        columns = tuple(
            Regressor(
                name=cause,
                sd=self.sd,
                fields=[ObservationDelta(markers=model.compliance * change[cause]) for change in changes],
                of_forces=OfInnerChange(cause),
            )
            for cause in self.causes
        )
        return [Signature(variant=ONE_WAY, columns=columns)]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The pit's parameters from the amounts."""
        return self.spec.within_bounds(*(self.value(amount) for amount in amounts))

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """That of the causes' amounts, to first order."""
        return {spec.name: Prior(self.value(0.0), self.sd) for spec in self.spec.searched}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The response with that pit. Raises FemFailure if the pit would leave the flesh."""
        pit = np.zeros(len(PIT))
        for cause, spec in zip(self.causes, self.spec.searched, strict=True):
            pit[PIT.index(cause)] = self.amount(parameters[spec.name])
        quantities = quadratic_surrogate(
            model.warm_starts,
            self.spec.name,
            pit / SPREAD,
            first_order=partial(_first_order, model),
            exact=partial(_exact, model),
        )
        return Response(unit=[unit for (unit,) in quantities])


def _first_order(model: CaseModel, theta: Float[np.ndarray, "4"]) -> Quantities:
    responses = []
    for recording in model.grasps:
        change = inner_changes(model, recording)
        more = sum(x * change[name] for x, name in zip(theta * SPREAD, PIT, strict=True))
        responses.append([recording.tracks.unit_displacement + more])
    return responses


def _exact(model: CaseModel, theta: Float[np.ndarray, "4"]) -> Quantities:
    mesh = with_pit_moved(model.mesh, theta * SPREAD)
    solids = {
        support: UnitModulusSolid.factorise(
            mesh, poisson_ratio=model.poisson_ratio, support=support, contact_nodes=solid.contact_nodes
        )
        for support, solid in model.base.solids.items()
    }

    def moved_under(recording: GraspResponse) -> list[np.ndarray]:
        there = replace(recording, solid=solids[recording.case.support])
        return [recording.whole(there.response_to(recording.patterns))]

    return model.each(moved_under)

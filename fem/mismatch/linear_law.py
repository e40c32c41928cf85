"""An effect that makes the flesh's law another linear one: one parameter, stiffness sum_i a_i(theta) K_i."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import bsr_array, csr_array

from fem.mismatch.effect import Response, Signature
from fem.mismatch.effect_spec import EffectSpec, ParameterSpec
from fem.mismatch.model.force_products import OfFlesh
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.reduced_law import Operator, ReducedLaw, first_changes, reduced_laws
from fem.mismatch.signature_variant import ONE_WAY, Variant


@dataclass(frozen=True, kw_only=True)
class LinearLaw:
    """The law of flesh whose stiffness is sum_i a_i(theta) K_i; theta is the effect's one parameter.

    `operators(forward)`: dK/dtheta at the plain law, and the K_i. `amounts(forward, theta)`: the a_i.
    `null(forward)`: the theta of the plain law, 0 unless given (Poisson's ratio has the category's).
    `sd`: prior standard deviation of theta about it. `positive`: theta is never below it.
    `needs_pit`: without a pit there is no such effect.
    """

    spec: EffectSpec
    sd: float
    operators: Callable[[ForwardModel], tuple[Operator, Sequence[Operator]]]
    amounts: Callable[[ForwardModel, float], Sequence[float]]
    null: Callable[[ForwardModel], float] = lambda forward: 0.0
    positive: bool = False
    needs_pit: bool = False

    @property
    def parameter(self) -> ParameterSpec:
        """The one that is searched for."""
        (parameter,) = self.spec.searched
        return parameter

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """dc/dtheta at the plain law; none where the law needs a pit and there is none."""
        if self.needs_pit and not len(forward.base.mesh.pit_nodes):
            return []
        derivative, _ = self.operators(forward)
        fields = [
            ObservationDelta(markers=forward.compliance * change)
            for change in first_changes(forward, derivative)
        ]
        return [
            Signature(
                variant=ONE_WAY,
                columns=(
                    Regressor(
                        name=self.parameter.name,
                        sd=self.sd,
                        fields=fields,
                        positive=self.positive,
                        of_forces=self.of_forces(forward),
                    ),
                ),
            )
        ]

    def of_forces(self, forward: ForwardModel) -> OfFlesh:
        """How dc/dtheta at the plain law follows from the forces: -K0^-1 (dK/dtheta) U."""
        derivative, _ = self.operators(forward)
        return OfFlesh(lambda recording, moved: -derivative(moved))

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount counts from the plain law."""
        spec = self.parameter
        return {spec.name: float(np.clip(self.null(forward) + amounts[0], spec.low, spec.high))}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The law of this parameter, in the reduced space."""
        amounts = self.amounts(forward, parameters[self.parameter.name])
        return Response(unit=[law.response(amounts) for law in self._laws(forward)])

    def _laws(self, forward: ForwardModel) -> list[ReducedLaw]:
        def laws() -> list[ReducedLaw]:
            derivative, parts = self.operators(forward)
            return reduced_laws(forward, derivative=derivative, parts=parts)

        return forward.memoised(self.spec.name, laws)


def plain_stiffness(forward: ForwardModel) -> Operator:
    """K0."""
    return matrix_operator(forward.stiffness)


def matrix_operator(matrix: csr_array | bsr_array) -> Operator:
    """A matrix over all nodes' displacements."""

    def times(displacement: Float[np.ndarray, "f m 3"]) -> Float[np.ndarray, "f m 3"]:
        flat = displacement.reshape(len(displacement), -1).T
        return np.ascontiguousarray((matrix @ flat).T).reshape(displacement.shape)

    return times


def stress_operator(
    forward: ForwardModel, stress: Callable[[Float[np.ndarray, "f m 4 6"]], Float[np.ndarray, "f m 4 6"]]
) -> Operator:
    """B' sigma(eps) of a law of stress that is linear in the strain."""
    return lambda displacement: forward.points.forces(stress(forward.points.strain(displacement)))

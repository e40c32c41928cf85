"""Effects that change the flesh's law by one parameter: stiffness sum_i a_i(theta) K_i.

fem.mismatch.model.finite_change computes how large deformation changes with the law.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import bsr_array, csr_array

from fem.elements.assembly import unit_lame_constants
from fem.materials.fung_neo_hookean import neo_hookean_stress
from fem.materials.strain_path import PathLaw
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.finite_change import finite_change, in_proportion
from fem.mismatch.model.force_noise import OfFlesh
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.model.reduced_law import Operator, ReducedLaw, first_changes, reduced_laws
from fem.mismatch.signature_variant import Variant


@dataclass(frozen=True, kw_only=True)
class LinearLaw(Effect):
    """The law of flesh whose stiffness is sum_i a_i(theta) K_i; theta is the effect's one parameter.

    `derivative(model)`: dK/dtheta at the plain law. `finite(model)`: its forces at finite strain.
    `parts(model)` and `amounts(theta)`: the K_i and a_i; by default K0 and dK/dtheta with 1 and theta.
    `null(model)`: theta of the plain law. `sd`: prior standard deviation of theta about it. `positive`:
    theta is never below it. A law `of_the_depth` requires a pit.
    """

    sd: float
    derivative: Callable[[CaseModel], Operator]
    finite: Callable[[CaseModel], Operator]
    parts: Callable[[CaseModel], Sequence[Operator]] | None = None
    amounts: Callable[[float], Sequence[float]] = lambda theta: (1.0, theta)
    null: Callable[[CaseModel], float] = lambda model: 0.0
    positive: bool = False
    of_the_depth: bool = False

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """dc/dtheta at the plain law: -K0^-1 (dK/dtheta) U at small strain, plus the change by large
        deformation.
        """
        if self.of_the_depth and not len(model.mesh.pit_nodes):
            return []
        derivative = self.derivative(model)
        changes = zip(self.at_small_strain(model), self._finite(model), strict=True)
        signature = Signature.of_markers(
            self.spec.searched[0].name,
            [small + model.compliance * more for small, more in changes],
            sd=self.sd,
            positive=self.positive,
            of_forces=OfFlesh(lambda recording, moved: -derivative(moved)),
        )
        return [signature]

    def at_small_strain(self, model: CaseModel) -> Fields:
        """-K0^-1 (dK/dtheta) U under the recordings' forces, mm per unit of theta."""
        return [model.compliance * small for small in self._first(model)]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The plain law's theta plus the amount."""
        return self.spec.within_bounds(self.null(model) + amounts[0])

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """That of theta about the plain law's."""
        return {self.spec.searched[0].name: Prior(self.null(model), self.sd)}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The response with this theta, in the reduced space."""
        theta = parameters[self.spec.searched[0].name]
        laws = model.memoised(self.spec.name, lambda: self._laws(model))
        small = [law.response(self.amounts(theta)) for law in laws]
        return Response(unit=in_proportion(small, model.plain, self._first(model), self._finite(model)))

    def _first(self, model: CaseModel) -> Fields:
        """dc/dtheta at small strain."""
        name = (self.spec.name, "first")
        return model.memoised(name, lambda: first_changes(model, self.derivative(model)))

    def _finite(self, model: CaseModel) -> Fields:
        """What large deformation adds to dc/dtheta."""
        return finite_change(
            model,
            self.spec.name,
            lambda: (self.finite(model), self.derivative(model)),
            amount=self.sd,
        )

    def _laws(self, model: CaseModel) -> list[ReducedLaw]:
        derivative = self.derivative(model)
        parts = (matrix_operator(model.stiffness), derivative)
        return reduced_laws(
            model, derivative=derivative, parts=parts if self.parts is None else self.parts(model)
        )


def piecewise_operator(
    model: CaseModel, law: PathLaw, *, weight: Float[np.ndarray, "m 4"] | None = None
) -> Operator:
    """Nodal forces, in single precision, of a stress that depends on the displacement gradient, times the
    points' weight.
    """
    return lambda displacement: model.pieces.forces(displacement, law, weight=weight)


def neo_hookean_operator(model: CaseModel, weight: Float[np.ndarray, "m 4"]) -> Operator:
    """The Neo-Hookean law times the points' weight."""
    constants = unit_lame_constants(model.poisson_ratio)
    return piecewise_operator(model, lambda gradient: neo_hookean_stress(gradient, *constants), weight=weight)


def matrix_operator(matrix: csr_array | bsr_array) -> Operator:
    """Multiplication of all nodes' displacements by a matrix."""

    def times(displacement: Float[np.ndarray, "f m 3"]) -> Float[np.ndarray, "f m 3"]:
        flat = displacement.reshape(len(displacement), -1).T
        return np.ascontiguousarray((matrix @ flat).T).reshape(displacement.shape)

    return times


def stress_operator(
    model: CaseModel, stress: Callable[[Float[np.ndarray, "f m 4 6"]], Float[np.ndarray, "f m 4 6"]]
) -> Operator:
    """B' sigma(eps) of a stress that is linear in the strain."""
    return lambda displacement: model.points.forces(stress(model.points.strain(displacement)))

"""Effects that give the flesh a law whose stress depends on the strain history.

Changes of the flesh in one recording persist in the next ones. Recordings are in the order in which they were
made, and each marker is compared with its own first touch in each. Signatures: the law's stress in the plain
model's field, for a few levels at which the law begins, relative to the plain model's own levels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.strain_path import PathLaw, Points, Tensors
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.stress_history import PathState, fixed_point, path_state, whole_response
from fem.mismatch.signature_variant import Variant, at_value, significant
from fem.solid.flesh_pieces import exceeded_by
from fem.solid.initial_stress import bounded


@dataclass(frozen=True, kw_only=True)
class PathLawEffect(Effect):
    """`spec`: its last parameter is the level, over E.

    `law(parameters, nu)`: the flesh's law. `seen(gradient, nu)`: the quantity that the law compares with the
    level. `symbol`: the level's symbol in labels. `relative`: levels of the signatures over the level that
    the share `exceeding` of the flesh's volume exceeds at some time. `unit_law(level, nu)`: the signatures'
    law. `name`, `sd`: name and prior of their amount. `from_amount`: the parameters before the level, from
    the amount. `frames`: approximate number of frames computed, of all recordings together.
    """

    law: Callable[[Parameters, float], PathLaw]
    seen: Callable[[Tensors, float], Points]
    symbol: str
    relative: tuple[float, ...]
    exceeding: float
    unit_law: Callable[[float, float], PathLaw]
    name: str
    sd: float
    from_amount: Callable[[float], tuple[float, ...]] = lambda amount: ()
    frames: int

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each level."""
        state, s = self._state(model), model.compliance
        _, level = self.largest_seen(model)
        levels = [relative * level for relative in self.relative]
        forces = [
            bounded(model.pieces.forces(s * state.linear, self.unit_law(at, model.poisson_ratio)), s)
            for at in levels
        ]
        return [
            Signature.of_markers(
                self.name,
                [-displacement for displacement in moved],
                sd=self.sd,
                variant=at_value(self.symbol, significant(at, 4)),
                positive=True,
            )
            for at, moved in zip(levels, state.marker_responses(forces), strict=True)
        ]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The signature's level and amount."""
        before = self.from_amount(max(float(amounts[0]), 0.0))
        return self.spec.within_bounds(*before, signature.variant.values[0])

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The parameters that correspond to a usual amount; none of the level."""
        usual = zip(self.spec.searched, self.from_amount(self.sd), strict=False)
        return {spec.name: Prior(0.0, sd) for spec, sd in usual}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """Equilibrium with the law, by fixed-point iteration. Raises FemFailure (NOT_CONVERGED)."""
        state = self._state(model)
        *others, level = (parameters[spec.name] for spec in self.spec.searched)
        as_seen = level / model.compliance ** self.spec.searched[-1].strain_power
        more = fixed_point(
            model,
            state,
            self.law(parameters, model.poisson_ratio),
            name=self.spec.name,
            place=np.array([*others, np.log(as_seen)]),
            together=True,
        )
        return Response(unit=whole_response(state, more))

    def largest_seen(self, model: CaseModel) -> tuple[Float[np.ndarray, "m 4"], float]:
        """Largest `seen` at each point of the plain model; level that `exceeding` of the flesh exceeds."""
        largest = model.pieces.measured(
            model.compliance * self._state(model).linear,
            lambda gradient: self.seen(gradient, model.poisson_ratio),
        ).max(axis=-1)
        return largest, exceeded_by(self.exceeding, largest, model.pieces.volume_mm3)

    def _state(self, model: CaseModel) -> PathState:
        return path_state(model, frames=self.frames, remembers=True)

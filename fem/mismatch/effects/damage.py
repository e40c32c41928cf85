"""`damage`: flesh that is softened for good where it once held much energy (Mullins).

The law is fem.materials.mullins_damage. What one recording has damaged the next ones find so: they come in
the order in which they were made.

Signatures: one for each of a few W0, relative to the energy that the plain model sees; the amount is dmax.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.mullins_damage import mullins_damage
from fem.materials.strain_path import strain_energy
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.stress_history import PathState, path_response, path_state
from fem.mismatch.signature_variant import AtValue, Variant, significant, value_of
from fem.solid.flesh_pieces import FleshPieces, exceeded_by

DMAX, W0 = "dmax", "W0_over_E"
PRIOR_SD = 0.3
"""Of dmax in the linear round, where 1 is flesh without stiffness: a half is far. Set by hand."""
RELATIVE = (0.1, 0.4, 1.6)
"""W0 of the signatures over the energy density that LARGE of the flesh exceeds at some time."""
LARGE = 0.05
"""Share of the flesh's volume: that under the pads, which is damaged first. Set by hand."""
FAR_DMAX, FAR_W0 = 0.25, 4.0
"""What is far for dmax, and for ln W0: units in which earlier runs are near or far."""
FRAMES = 44
"""Frames of all recordings together."""

SPEC = EffectSpec(
    name="damage",
    rank=130,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh is softer the second time it is pressed",
        meaning="The first squeeze breaks some of the flesh's structure, so that later ones meet less "
        "resistance.",
        advice="Use the first squeeze of every fruit only, lower the force, and do not grasp a place twice.",
    ),
    parameters=(
        number(
            DMAX,
            "1",
            "most of the resistance that is lost",
            limits=(0.0, 1.0),
            low=0.02,
            high=0.95,
            model_share=0.04,
        ),
        number(
            W0,
            "1",
            "energy at which it is lost, over E",
            limits=(0.0, 1e6),
            low=1e-6,
            high=1.0,
            log=True,
            model_share=0.1,
            strain_power=2.0,
        ),
    ),
    remembers_grasps=True,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class Damage:
    """The effect; see the module."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """One for each W0, its amount dmax."""
        state = path_state(forward, frames=FRAMES, remembers=True)
        nu, s = forward.poisson_ratio, forward.compliance
        pieces = FleshPieces.whole(forward.points, workers=forward.workers)
        level = _level(pieces, state, compliance=s, poisson_ratio=nu)
        levels = [relative * level for relative in RELATIVE]
        laws = [mullins_damage(1.0, level_MPa, poisson_ratio=nu) for level_MPa in levels]
        moved = state.marker_responses([pieces.forces(s * state.linear, law) for law in laws])
        signatures = []
        for own_level, more in zip(levels, moved, strict=True):
            fields = [ObservationDelta(markers=-displacement) for displacement in more]
            signatures.append(
                Signature(
                    variant=AtValue(symbol="W0", value=significant(own_level, 3)),
                    columns=(Regressor(name=DMAX, sd=PRIOR_SD, fields=fields, positive=True),),
                )
            )
        return signatures

    def start(
        self,
        forward: ForwardModel,
        signature: Signature,
        amounts: Float[np.ndarray, " k"],
    ) -> dict[str, float]:
        """The signature's W0. Damaged flesh strains more: dmax is less than the amount, x / (1 + x)."""
        amount = max(float(amounts[0]), 0.0)
        return {DMAX: float(np.clip(amount / (1 + amount), 0.05, 0.8)), W0: value_of(signature.variant)}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The law in the field that it itself brings."""
        state = path_state(forward, frames=FRAMES, remembers=True)
        pieces = FleshPieces.whole(forward.points, workers=forward.workers)
        law = mullins_damage(parameters[DMAX], parameters[W0], poisson_ratio=forward.poisson_ratio)
        seen_W0 = np.log(parameters[W0] / forward.compliance**2)
        place = np.array([parameters[DMAX] / FAR_DMAX, seen_W0 / FAR_W0])
        return Response(unit=path_response(forward, state, pieces, law, name=self.spec.name, place=place))


def _level(pieces: FleshPieces, state: PathState, *, compliance: float, poisson_ratio: float) -> float:
    """The W/E that LARGE of the flesh exceeds at some time in the plain model."""
    energy = pieces.measured(
        compliance * state.linear, lambda gradient: strain_energy(gradient, poisson_ratio=poisson_ratio)
    )
    return exceeded_by(LARGE, energy.max(axis=-1), pieces.volume_mm3)


EFFECT: Effect = Damage()

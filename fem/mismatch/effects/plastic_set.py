"""`plastic_set`: flesh that yields where it is strained most, and keeps its new shape.

The law is fem.materials.von_mises_set. What one recording has set the next ones find so: they come in the
order in which they were made, and a marker is compared with its own first touch in each.

Signatures: one for each of a few Y, relative to the stress that the plain model sees; what the law makes of
the plain model's field, of which the amount is 1 to 3: flesh that has yielded sheds load on its neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.strain_path import deviator, von_mises
from fem.materials.von_mises_set import von_mises_set
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.stress_history import PathState, path_response, path_state
from fem.mismatch.signature_variant import AtValue, Variant, significant, value_of
from fem.solid.flesh_pieces import FleshPieces, exceeded_by
from fem.solid.initial_stress import bounded

YIELD = "yield_over_E"
PRIOR_SD = 1.5
"""Of the signature's amount, which is 1 at its own Y. Set by hand."""
RELATIVE = (0.5, 0.7, 0.85)
"""Y of the signatures over the stress that LARGE of the flesh exceeds at some time."""
LARGE = 0.002
"""Share of the flesh's volume: that which yields first. Set by hand."""
MARGIN = 0.7
"""Elements whose plain stress stays below this share of Y are left out: they do not yield."""
FRAMES = 48
"""Frames of all recordings together."""

SPEC = EffectSpec(
    name="plastic_set",
    rank=120,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the grasp itself leaves a lasting dent",
        meaning="The flesh does not spring back: it was pressed beyond what it bears.",
        advice="Lower the gripper's force for this lot; the fruit grasped so far may show bruises.",
    ),
    parameters=(
        number(
            YIELD,
            "1",
            "stress at which a dent stays, over E",
            limits=(0.0, 1e3),
            low=1e-3,
            high=0.5,
            log=True,
            model_share=0.05,
            strain_power=1.0,
        ),
    ),
    remembers_grasps=True,
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class PlasticSet:
    """The effect; see the module."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """One for each Y, its amount 1 to 3 where the law holds."""
        state = path_state(forward, frames=FRAMES, remembers=True)
        stress, level = _stress_seen(forward, state)
        yields = [relative * level for relative in RELATIVE]
        forces = []
        for Y in yields:
            pieces = FleshPieces.of(forward.points, stress > MARGIN * Y, workers=forward.workers)
            law = von_mises_set(Y, poisson_ratio=forward.poisson_ratio)
            forces.append(bounded(pieces.forces(forward.compliance * state.linear, law), forward.compliance))
        signatures = []
        for Y, more in zip(yields, state.marker_responses(forces), strict=True):
            fields = [ObservationDelta(markers=-displacement) for displacement in more]
            signatures.append(
                Signature(
                    variant=AtValue(symbol="Y", value=significant(Y, 4)),
                    columns=(Regressor(name="set", sd=PRIOR_SD, positive=True, fields=fields),),
                )
            )
        return signatures

    def start(
        self,
        forward: ForwardModel,
        signature: Signature,
        amounts: Float[np.ndarray, " k"],
    ) -> dict[str, float]:
        """The signature's Y."""
        return {YIELD: value_of(signature.variant)}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """The law in the field that it itself brings."""
        state = path_state(forward, frames=FRAMES, remembers=True)
        Y = parameters[YIELD]
        pieces = FleshPieces.of(
            forward.points, _stress_seen(forward, state)[0] > MARGIN * Y, workers=forward.workers
        )
        return Response(
            unit=path_response(
                forward,
                state,
                pieces,
                von_mises_set(Y, poisson_ratio=forward.poisson_ratio),
                name=self.spec.name,
                place=np.array([np.log(Y / forward.compliance)]),
            )
        )


def _stress_seen(forward: ForwardModel, state: PathState) -> tuple[Float[np.ndarray, " m"], float]:
    """Largest von Mises stress over E in each element in the plain model; what LARGE of the flesh exceeds."""
    nu = forward.poisson_ratio
    pieces = FleshPieces.whole(forward.points, workers=forward.workers)
    largest = pieces.measured(
        forward.compliance * state.linear, lambda gradient: von_mises(deviator(gradient), poisson_ratio=nu)
    ).max(axis=-1)
    return largest.max(axis=1), exceeded_by(LARGE, largest, pieces.volume_mm3)


EFFECT: Effect = PlasticSet()

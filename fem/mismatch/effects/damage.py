"""`damage`: flesh that is softened for good where it once held much energy (Mullins).

    sigma = (1 - D) C eps,  D = dmax (1 - exp(-Wmax / W0)),  Wmax = largest W so far,  W = eps : C : eps / 2

C and W those of healthy flesh, small strain; discontinuous damage, driven by the largest energy (Simo 1987,
"On a fully three-dimensional finite-strain viscoelastic damage model", Computer Methods in Applied Mechanics
and Engineering 60). What one recording has damaged the next ones find so: they come in the order in which
they were made.

Signatures: one for each of a few W0, relative to the energy that the plain model sees; the amount is dmax.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.stress_history import PathState, first_guess, fixed_point, keep_run, path_state
from fem.mismatch.signature_variant import AtValue, Variant, significant, value_of
from fem.solid.flesh_pieces import FleshPieces, PieceLaw, Tensors, exceeded_by
from fem.solid.small_strain import linear_stress, strain_energy

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
)
"""Limits and bounds are wide, errors measured: see fem.mismatch.effect_spec."""


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
        found = []
        for relative in RELATIVE:
            more = -state.response(pieces.forces(s * state.linear, _lost(1.0, relative * level, nu)))
            fields = [ObservationDelta(markers=own) for own in state.at_markers(more)]
            found.append(
                Signature(
                    variant=AtValue(symbol="W0", value=significant(relative * level, 3)),
                    columns=(Regressor(name=DMAX, sd=PRIOR_SD, fields=fields, positive=True),),
                )
            )
        return found

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
        law = _lost(parameters[DMAX], parameters[W0], forward.poisson_ratio)
        seen_W0 = np.log(parameters[W0] / forward.compliance**2)
        place = np.array([parameters[DMAX] / FAR_DMAX, seen_W0 / FAR_W0])
        more = fixed_point(
            state,
            lambda moved: pieces.forces(moved, law),
            compliance=forward.compliance,
            stiffer=np.ones(len(state.linear)),
            start=first_guess(forward, self.spec.name, place),
            together=True,
        )
        keep_run(forward, self.spec.name, place, more)
        return Response(
            unit=[
                recording.tracks.unit_displacement + own
                for recording, own in zip(forward.base.grasps, state.at_markers(more), strict=True)
            ]
        )


def damaged_share(
    energy: Float[np.ndarray, "*x f"], dmax: float, W0_over_E: float
) -> Float[np.ndarray, "*x f"]:
    """D in frames in order of time, from W/E."""
    return np.asarray(-dmax * np.expm1(-np.maximum.accumulate(energy, axis=-1) / W0_over_E))


def _lost(dmax: float, W0_over_E: float, nu: float) -> PieceLaw:
    """-D C eps."""

    def law(gradient: Tensors) -> Tensors:
        share = damaged_share(strain_energy(gradient, poisson_ratio=nu), dmax, W0_over_E)
        return np.asarray(-share[:, :, None, None] * linear_stress(gradient, poisson_ratio=nu))

    return law


def _level(pieces: FleshPieces, state: PathState, *, compliance: float, poisson_ratio: float) -> float:
    """The W/E that LARGE of the flesh exceeds at some time in the plain model."""
    energy = pieces.measured(
        compliance * state.linear, lambda gradient: strain_energy(gradient, poisson_ratio=poisson_ratio)
    )
    return exceeded_by(LARGE, energy.max(axis=-1), pieces.volume_mm3)


EFFECT: Effect = Damage()

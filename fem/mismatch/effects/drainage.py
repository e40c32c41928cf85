"""`drainage`: flesh that is held loses juice. Its resistance to losing volume fades, that to shear does not.

    sigma = 2 mu eps + lambda (tr eps - s m) 1,      tau m' = tr eps - m

s: the share of lambda that fades, m: what of the volumetric strain has drained. Poroelasticity (Biot 1941)
with one drainage time for all flesh, however far the juice has to go; as a relaxing bulk modulus in
Christensen, "Theory of Viscoelasticity", 1982, chapter 1. E is that of the first instant.

Solved in the space of fem.mismatch.model.reduced_law, where the law falls apart into modes
(fem.mismatch.model.fading_volume). Signature: the derivative in s at s = 0, for a row of tau.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants
from fem.materials.relaxing_arm import RelaxingArm, lagging
from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.linear_law import matrix_operator
from fem.mismatch.model.fading_volume import FadingVolume
from fem.mismatch.model.forward_model import ForwardModel, over_all_frames
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.reduced_law import first_changes, reduced_laws
from fem.mismatch.signature_variant import AtValue, Variant, value_of

SHARE, TAU = "volume_share", "tau_s"
TAUS_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Drainage times of the signatures, s: as those of `viscoelastic`. Set by hand."""
LEAST, MOST = 0.01, 0.98
"""Bounds of the share: next to none; with all of lambda gone flesh would have a Poisson's ratio of zero. Set
by hand."""
SHORTEST_S, LONGEST_S = 0.05, 200.0
"""Bounds of tau, s: a frame of a recording, and ten times its hold. Set by hand."""

SPEC = EffectSpec(
    name="drainage",
    rank=15,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh loses juice while it is held: it gives up volume slowly",
        meaning="Under a steady squeeze the flesh's resistance to losing volume fades, as juice moves out of "
        "it, while its resistance to a change of shape stays.",
        advice="Compare fruit at the same speed and hold time, or apply the effect to the batch so that the "
        "modulus is the one at the first instant.",
    ),
    parameters=(
        number(
            SHARE,
            "1",
            "share of the resistance to losing volume (Lame's lambda) that fades",
            limits=(0.0, 1.0),
            low=LEAST,
            high=MOST,
            model_share=0.05,
        ),
        number(
            TAU,
            "s",
            "time over which it fades",
            limits=(1e-6, 1e6),
            low=SHORTEST_S,
            high=LONGEST_S,
            log=True,
            model_share=0.1,
        ),
    ),
    knows_time=True,
)
"""By hand, wide: `limits`, `low`, `high`, and `model_share` until there are cases to measure it on."""


@dataclass(frozen=True)
class Drainage:
    """One drainage time; see the module."""

    spec: EffectSpec = SPEC

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """dc/ds at s = 0, one for each tau: what a lower lambda adds, lagging by tau."""
        return [
            Signature(
                variant=AtValue(symbol="tau", value=tau, unit="s"),
                columns=(
                    Regressor(
                        name=f"volume share, tau {tau:g} s",
                        sd=0.5,
                        positive=True,
                        fields=[
                            ObservationDelta(markers=forward.compliance * drained)
                            for drained in _drained(forward, tau)
                        ],
                    ),
                ),
            )
            for tau in TAUS_S
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount a counts drainage as if it went on in proportion: s b / (1 - s b) = a b of a mode of
        volume share b, and tau as much shorter than its retardation time."""
        b = float(np.mean([volume.typical_share for volume in _fading_volumes(forward)]))
        arm = RelaxingArm.of_creep(b * max(float(amounts[0]), 0.0), value_of(signature.variant))
        return {
            SHARE: float(np.clip(arm.g / b, 2 * LEAST, 0.9)),
            TAU: float(np.clip(arm.tau_s, SHORTEST_S, LONGEST_S)),
        }

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Exact in time for force histories that run straight between frames."""
        return Response(
            unit=[
                volume.response(recording, share=parameters[SHARE], tau_s=parameters[TAU])
                for volume, recording in zip(_fading_volumes(forward), forward.base.grasps, strict=True)
            ]
        )


def _drained(forward: ForwardModel, tau_s: float) -> list[Float[np.ndarray, "_f _n 3"]]:
    """dc/ds: at once nothing, in time that of the elastic law."""
    responses = []
    for recording, first in zip(forward.base.grasps, _first_orders(forward), strict=True):
        whole = over_all_frames(recording, first)
        responses.append(lagging(whole, recording.case.history.time_s, tau_s)[recording.used])
    return responses


def fading_forces(forward: ForwardModel, moved: Float[np.ndarray, "r m 3"]) -> Float[np.ndarray, "r m 3"]:
    """lambda K_lambda U: nodal forces by which the flesh resists losing volume, all of which may fade."""
    _, lame = unit_lame_constants(forward.poisson_ratio)
    volume = matrix_operator(next(iter(forward.base.solids.values())).parts.k_lambda)
    return np.asarray(lame * volume(moved))


def _first_orders(forward: ForwardModel) -> list[Float[np.ndarray, "_f _n 3"]]:
    """dc/ds of every recording where s is gone at once."""

    def compute() -> list[Float[np.ndarray, "_f _n 3"]]:
        return first_changes(forward, lambda moved: -fading_forces(forward, moved))

    return forward.memoised((SPEC.name, "first order"), compute)


def _fading_volumes(forward: ForwardModel) -> list[FadingVolume]:
    """Of every recording, solved for once."""

    def compute() -> list[FadingVolume]:
        parts = next(iter(forward.base.solids.values())).parts
        mu, lame = unit_lame_constants(forward.poisson_ratio)
        volume = matrix_operator(parts.k_lambda)
        laws = reduced_laws(
            forward,
            derivative=lambda moved: -fading_forces(forward, moved),
            parts=(matrix_operator(parts.k_mu), volume),
        )
        return [FadingVolume.of(law, mu=mu, lame=lame) for law in laws]

    return forward.memoised(SPEC.name, compute)


EFFECT: Effect = Drainage()

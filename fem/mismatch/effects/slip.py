"""`slip`: the skin slides over a pad where the shear would exceed Coulomb's cone, |f_t| <= mu f_n.

The recorded forces are what the friction lets through, so s c is right for the skin; but a marker, which is
gel, stays behind the skin by the path w that the skin has slid over it (fem.mismatch.model.slip_path):

    y(t) = X + s c(t) + R q(t) - w(t; mu) + noise

Signature: -w for a few mu, amount 1. Smaller mu than the markers' own ratios of shear to pressure allow are
left out (fem.mismatch.evidence.friction_cone): whatever else the plain model lacks, no such cone explains it.
Coulomb's law: Johnson 1985, Contact Mechanics, chapter 7.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure
from fem.mismatch.effect import Amounts, Effect, Parameters, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number
from fem.mismatch.evidence.friction_cone import ShearRatios, least_mu, shear_ratios, spring_ratio
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.slip_path import slip_path
from fem.mismatch.signature_variant import Variant, at_value

MU = "mu"
STEPS = (1.05, 1.3, 1.6, 2.0, 2.5, 3.1)
"""The mu looked at, over the smallest that the cone allows."""
LOWEST, HIGHEST = 0.03, 0.8
"""Bounds of mu: wet gel on wax above the least, dry skin that sticks in every grasp at the greatest. Set by
hand."""
LEAST_OF_PATH = 0.5
"""Share of a mu's path below which it is not that path which is seen. Set by hand: from one of the mu looked
at to the next it shortens by a third."""
SEEN_MM = 0.002
"""A path that is nowhere longer than this shows nothing."""

SPEC = EffectSpec(
    name="slip",
    rank=110,
    family="interaction",
    scope=Scope.LOT,
    words=EffectWords(
        short="the fruit slips between the pads",
        meaning="The pads slide over the skin: wax, juice or dust makes it slippery.",
        advice="Wipe fruit and pads dry, close the gripper a little further and slower, and record again.",
    ),
    parameters=(
        number(
            MU,
            "1",
            "friction between pad and skin",
            limits=(0.0, 100.0),
            low=LOWEST,
            high=HIGHEST,
            log=True,
            model_share=0.2,
        ),
    ),
)
"""By hand, wide: limits and bounds. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


class Slip(Effect):
    """The effect; see the module."""

    says_more = True

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each mu at which something slips."""
        least = least_mu(_ratios(model))
        signatures = []
        for mu in (step * least for step in STEPS if step * least < HIGHEST):
            variant = at_value("mu", round(mu, 4))
            try:
                paths = _paths(model, mu)
            except FemFailure as failure:
                signatures.append(Signature(variant=variant, columns=(), untried=failure.detail))
                continue
            if max(float(np.abs(path).max()) for path in paths) > SEEN_MM:
                behind = [-path for path in paths]
                signatures.append(
                    Signature.of_markers(
                        "path", behind, sd=1.0, variant=variant, positive=True, least=LEAST_OF_PATH
                    )
                )
        return signatures

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The signature's own mu: its amount is one."""
        return self.spec.within_bounds(signature.variant.values[0])

    def auxiliary_log_likelihood(self, model: CaseModel, parameters: Parameters, variant: Variant) -> float:
        """Markers piled up on this cone."""
        return max(_ratios(model).log_ratio(parameters[MU]), 0.0)

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The markers behind the skin by the path slid."""
        return Response.plain(model, shift_mm=[-path for path in _paths(model, parameters[MU])])


EFFECT: Effect = Slip(spec=SPEC)


def _ratios(model: CaseModel) -> ShearRatios:
    return model.memoised("shear ratios", lambda: shear_ratios(model))


def _paths(model: CaseModel, mu: float) -> list[Float[np.ndarray, "_f _n 3"]]:
    """Displacement of every recording's markers with Coulomb friction `mu` on the pads."""
    stiffness = {name: spring_ratio(model, name) for name in model.pads}
    return [
        slip_path(
            recording,
            model.marker_equations(recording),
            compliance=model.compliance,
            mu=mu,
            spring_ratio=np.array([stiffness[name] for name in recording.pad_names])[recording.pad_of_marker],
        )
        for recording in model.grasps
    ]

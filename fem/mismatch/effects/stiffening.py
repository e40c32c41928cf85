"""`stiffening`: flesh becomes stiffer with strain.

The law is fem.materials.fung_neo_hookean. Strong stiffening involves strains of about 0.1, for which a
small-strain law would give a b that is an eighth too large.

The signature is b W/mu times the linear stress, W of small strain, in the plain model's field. It
overestimates the change, since stiffer flesh strains less; `start` says why it uses the amount unchanged.
Large deformation is part of the plain model (fem.mismatch.evidence.beyond_small_strain) and of this law:
refits omit the former.
"""

from collections.abc import Sequence

from fem.materials.fung_neo_hookean import fung_at_small_strain
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.stress_history import beyond_linear, stiffening_path, whole_response
from fem.mismatch.signature_variant import Variant

B = "b"
PRIOR_SD = 30.0
"""Prior of b in the linear round. Set by hand, as large as strong stiffening in the samples
(samples.mismatch.injected)."""
SPEC = EffectSpec(
    name="stiffening",
    rank=20,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh stiffens the further it is pressed",
        meaning="The resistance grows faster than the squeeze: a deep grasp makes the fruit look firmer "
        "than a light one. Some of it is large deformation alone, which no soft fruit is without.",
        advice="Grasp all fruit equally deep and gently, or apply the effect so that the modulus is that of "
        "the first touch.",
    ),
    parameters=(
        EffectParameter(
            B,
            "1",
            "how fast the flesh stiffens",
            limits=(-10.0, 1e3),
            low=0.1,
            high=400.0,
            log=True,
            strain_power=-2.0,
            low_is_a_law=True,
        ),
    ),
    holds_large_deformation=True,
)
"""Limits and bounds are set by hand, wide."""


class Stiffening(Effect):
    """The effect; see the module."""

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """That of the exponential, with amount b."""
        state = stiffening_path(model)
        nu, s = model.poisson_ratio, model.compliance
        forces = model.pieces.forces(s * state.linear, fung_at_small_strain(poisson_ratio=nu))
        moved = [-displacement for displacement in state.marker_responses([forces])[0]]
        return [Signature.of_markers(B, moved, sd=PRIOR_SD, positive=True)]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The amount within the bounds: at the best-fitting modulus both halves of its error cancel."""
        return self.spec.within_bounds(max(float(amounts[0]), 1.0))

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The rate has that of its bounds."""
        return {}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """Neo-Hookean flesh with Fung's factor; finite strain, dead loads on the unloaded skin."""
        more = beyond_linear(model, parameters[B])
        return Response(unit=whole_response(stiffening_path(model), more))


EFFECT: Effect = Stiffening(spec=SPEC)

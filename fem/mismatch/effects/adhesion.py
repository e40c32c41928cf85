"""`adhesion`: the gel sticks to the skin and pulls at it while the jaws open, until it is reach_mm away.

    f_n = -k_n s,      0 < s < reach_mm,      at a marker that has touched and whose skin now draws away by s

(a gel of springs with a finite reach: Dugdale's law of adhesion with springs instead of elastic bodies;
Johnson 1985, Contact Mechanics, chapter 5.5). The recorded forces include that pull, so the plain model's
response is correct: s c(t) and E do not change. The contact itself reveals the effect: markers pull after
they have touched and did not pull before (fem.mismatch.model.pulling_markers). The reach is the upper end of
the pulled markers' stretches, estimated as twice the largest minus the second largest (Robson and Whitlock
1964, "Estimation of a truncation point", Biometrika 51).
"""

from collections.abc import Sequence

from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.signature_variant import ONE_WAY, Variant

REACH = "reach_mm"

SPEC = EffectSpec(
    name="adhesion",
    rank=190,
    family="interaction",
    scope=Scope.LOT,
    words=EffectWords(
        short="the gel sticks to the skin and pulls at it while the jaws open",
        meaning="Pads and skin let go of each other late. The recorded forces hold that pull, so the modulus "
        "is right as it is; the skin may be torn where it is tender.",
        advice="Dust or wipe the pads, and open the jaws more slowly. Nothing needs to be applied: grading "
        "uses the forces with the pull in them.",
    ),
    parameters=(
        EffectParameter(
            REACH,
            "mm",
            "how far the gel is drawn out before it lets go",
            limits=(0.0, 50.0),
            low=1e-3,
            high=5.0,
        ),
    ),
    in_recorded_forces=True,
)
"""Limits and bounds are set by hand, wide."""


class Adhesion(Effect):
    """The effect; see the module."""

    seen_directly = True

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One without columns, if markers pull."""
        return [Signature(variant=ONE_WAY, columns=())] if model.gels_stick else []

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The measured reach."""
        return self.spec.within_bounds(model.pull.reach_mm[0])

    def direct_evidence(self, model: CaseModel) -> float:
        """Evidence of the markers that pull."""
        return model.pull.evidence

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The measured reach."""
        return {REACH: Prior(*model.pull.reach_mm, measured=True)}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The plain model's response: the recorded forces include the pull."""
        return Response.plain(model)


EFFECT: Effect = Adhesion(spec=SPEC)

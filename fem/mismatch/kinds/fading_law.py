"""Effects in which a share of the flesh's resistance fades under load, with one time constant.

The faded part follows the elastic response with a lag (fem.materials.relaxing_arm). Signature: the derivative
with respect to the share, at zero, for several time constants.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.relaxing_arm import RelaxingArm, lagging
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields, GraspResponse
from fem.mismatch.signature_variant import Variant, at_value

TAUS_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Time constants of the signatures, s: threefold apart, from the shortest press to beyond the hold. Set by
hand."""
PRIOR_SD = 0.5
"""Prior of the share: half of the resistance. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class FadingLaw(Effect):
    """The parameters of `spec` are the share and the time constant, s.

    `at_once(model)`: dc/d(share) of every recording for a share that fades instantly, mm MPa.
    `response(model, share, tau_s)`: what fading adds to c. `weight(model)`: mean over modes of the part of
    their resistance that can fade.
    """

    at_once: Callable[[CaseModel], Fields]
    response: Callable[[CaseModel, float, float], Fields]
    weight: Callable[[CaseModel], float] = lambda model: 1.0

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each tau: zero at first; it tends to that of an instant change of the elastic law."""
        name = self.spec.searched[0].name
        changes = model.memoised((self.spec.name, "at once"), lambda: self.at_once(model))
        return [
            Signature.of_markers(
                f"{name}, tau {tau:g} s",
                [
                    model.compliance * lagged(recording, change, tau)
                    for recording, change in zip(model.grasps, changes, strict=True)
                ],
                sd=PRIOR_SD,
                variant=at_value("tau", tau, "s"),
                positive=True,
            )
            for tau in TAUS_S
        ]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """Converts the amount a, linear in the fading, to the share s: for a mode of weight b,
        s b / (1 - s b) = a b. tau is 1 - s b times the retardation time."""
        weight = self.weight(model)
        arm = RelaxingArm.of_creep(weight * max(float(amounts[0]), 0.0), signature.variant.values[0])
        return self.spec.within_bounds(arm.g / weight, arm.tau_s)

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The share that corresponds to a usual amount; none of tau."""
        share = self.spec.searched[0].name
        return {share: Prior(0.0, self.start(model, signature, np.array([PRIOR_SD]))[share])}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """The response, exact for force histories that are linear between frames."""
        share, tau_s = (parameters[spec.name] for spec in self.spec.searched)
        return Response.plain(model, self.response(model, share, tau_s))


def lagged(
    recording: GraspResponse,
    values: Float[np.ndarray, "f ..."],
    retardation_s: float | Float[np.ndarray, "..."],
) -> Float[np.ndarray, "f ..."]:
    """h of fem.materials.relaxing_arm in the frames used."""
    whole = recording.over_all_frames(values)
    return np.asarray(lagging(whole, recording.case.history.time_s, retardation_s)[recording.used])

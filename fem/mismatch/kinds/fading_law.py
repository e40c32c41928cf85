"""An effect that lets a share of the flesh's resistance fade while it is held, by one time.

What has faded follows the elastic response with a lag (fem.materials.relaxing_arm). Signature: the derivative
in the share at none, for a row of times.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.relaxing_arm import RelaxingArm, lagging
from fem.mismatch.effect import Response, Signature
from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel, over_all_frames
from fem.mismatch.signature_variant import AtValue, Variant, value_of

TAUS_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Times of the signatures, s: threefold apart, from the shortest press to beyond the hold. Set by hand."""
PRIOR_SD = 0.5
"""Of the share: half of the resistance. Set by hand."""

Fields = list[Float[np.ndarray, "_f _n 3"]]


@dataclass(frozen=True, kw_only=True)
class FadingLaw:
    """The parameters of `spec` are the share and the time, s.

    `at_once(forward)`: dc/d(share) of every recording where the share is gone at once, mm MPa.
    `response(forward, share, tau_s)`: what fading adds to c. `weight(forward)`: how much of a mode's
    resistance is of the kind that fades, on average.
    """

    spec: EffectSpec
    at_once: Callable[[ForwardModel], Fields]
    response: Callable[[ForwardModel, float, float], Fields]
    weight: Callable[[ForwardModel], float] = lambda forward: 1.0

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """One for each tau: at once nothing, in time that of the elastic law."""
        name = self.spec.searched[0].name
        changes = forward.memoised((self.spec.name, "at once"), lambda: self.at_once(forward))
        return [
            Signature.of_markers(
                f"{name}, tau {tau:g} s",
                [
                    forward.compliance * lagged(recording, change, tau)
                    for recording, change in zip(forward.base.grasps, changes, strict=True)
                ],
                sd=PRIOR_SD,
                variant=AtValue(symbol="tau", value=tau, unit="s"),
                positive=True,
            )
            for tau in TAUS_S
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The amount a counts fading in proportion: of a mode of weight b, s b / (1 - s b) = a b; tau is as
        much shorter than its retardation time."""
        weight = self.weight(forward)
        arm = RelaxingArm.of_creep(weight * max(float(amounts[0]), 0.0), value_of(signature.variant))
        return self.spec.within_bounds(arm.g / weight, arm.tau_s)

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Exact for force histories that run straight between frames."""
        share, tau_s = (parameters[spec.name] for spec in self.spec.searched)
        return Response.plain(forward, self.response(forward, share, tau_s))


def lagged(
    recording: GraspResponse,
    values: Float[np.ndarray, "f ..."],
    retardation_s: float | Float[np.ndarray, "..."],
) -> Float[np.ndarray, "f ..."]:
    """h of fem.materials.relaxing_arm, in the frames used."""
    whole = over_all_frames(recording, values)
    return np.asarray(lagging(whole, recording.case.history.time_s, retardation_s)[recording.used])

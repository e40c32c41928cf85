"""`viscoelastic`: the flesh relaxes.  E(t) = E (1 - g + g exp(-t / tau))

With Poisson's ratio constant every displacement under given forces is the elastic one, crept (correspondence
principle; Christensen 1982, Theory of Viscoelasticity, chapter 2):

    u(t) = s [c(t) + g / (1 - g) h(t)],      h' = (c - h) (1 - g) / tau

s = 1/E of the first instant. Signature: the same for g -> 0, for a row of tau.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.materials.relaxing_arm import lagging
from fem.mismatch.effect import Family, ParameterSpec, Response, Signature
from fem.mismatch.model.forward_model import ForwardModel, over_all_frames
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor

TAUS_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Relaxation times of the signatures, s: threefold apart, from the shortest press to beyond the hold. Set by
hand."""


@dataclass(frozen=True)
class Viscoelastic:
    """One relaxing arm."""

    name: str = "viscoelastic"
    family: Family = "object"
    parameters: tuple[ParameterSpec, ...] = (
        ParameterSpec(name="g", unit="1", low=0.01, high=0.95, model_share=0.03),
        ParameterSpec(name="tau_s", unit="s", low=0.05, high=200.0, log=True, model_share=0.05),
    )

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """g / (1 - g) h, one for each tau."""
        return [
            Signature(
                label=f"tau {tau:g} s",
                columns=(
                    Regressor(
                        name=f"g, tau {tau:g} s",
                        sd=0.5,
                        positive=True,
                        fields=[
                            ObservationDelta(markers=forward.compliance * crept)
                            for crept in _crept(forward, tau)
                        ],
                    ),
                ),
            )
            for tau in TAUS_S
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """From the retarded share and time to those of relaxation."""
        ratio = float(np.clip(amounts[0], 0.02, 5.0))
        g = ratio / (1 + ratio)
        return {"g": g, "tau_s": float(signature.label.split()[1]) * (1 - g)}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], choice: str) -> Response:
        """Exact for force histories that run straight between frames."""
        g, tau_s = parameters["g"], parameters["tau_s"]
        crept = _crept(forward, tau_s / (1 - g))
        grasps = forward.base.grasps
        return Response(
            unit=[
                recording.tracks.unit_displacement + g / (1 - g) * own
                for recording, own in zip(grasps, crept, strict=True)
            ]
        )


def _crept(forward: ForwardModel, retardation_s: float) -> list[Float[np.ndarray, "f n 3"]]:
    """h: nothing at once, in time all of c."""
    found = []
    for recording in forward.base.grasps:
        whole = over_all_frames(recording, recording.tracks.unit_displacement)
        found.append(lagging(whole, recording.case.history.time_s, retardation_s)[recording.used])
    return found


EFFECT = Viscoelastic()

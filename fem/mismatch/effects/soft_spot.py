"""`soft_spot`: a ball in the flesh whose modulus is `ratio` times that outside.

    K = K0 - (1 - ratio) K1,      K1 the stiffness of the flesh inside

Signature: K0^-1 K1 U0, at the few places where it explains best what the plain model leaves (fem.mismatch.
spot_search). Its amount is not 1 - ratio (drop_of).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from fem.mismatch.effect import Family, ParameterSpec, Response, Signature
from fem.mismatch.localisation.spot_search import Spot, best_spots
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.spot_response import softened, to_first_order
from fem.solid.inclusion import ball_stiffness, drop_of

CENTRE = ("centre_mm.0", "centre_mm.1", "centre_mm.2")
RADIUS, RATIO = "radius_mm", "ratio"
MIDDLE_RATIO = 0.35
"""Of the moduli: the spot whose drop is the prior's standard deviation. Set by hand, a plain bruise."""
RATIOS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85)
"""Of the moduli, tried as starts: from next to nothing to next to sound."""


@dataclass(frozen=True)
class SoftSpot:
    """The effect; see the module."""

    name: str = "soft_spot"
    family: Family = "object"
    parameters: tuple[ParameterSpec, ...] = (
        *(
            ParameterSpec(
                name=name, unit="mm", low=-500.0, high=500.0, spread=40.0, model_sd=0.5, model_share=0.0
            )
            for name in CENTRE
        ),
        ParameterSpec(name=RADIUS, unit="mm", low=3.0, high=10.0, log=True, model_share=0.08),
        ParameterSpec(name=RATIO, unit="1", low=0.05, high=0.95, model_share=0.12),
    )

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """One for each of the best places."""
        spots = best_spots(forward, forward.sight.observed(_left(forward)))
        sd = drop_of(MIDDLE_RATIO, forward.poisson_ratio)
        return [
            Signature(
                label=label_of(spot),
                columns=(Regressor(name="drop", sd=sd, fields=_fields(forward, spot), positive=True),),
            )
            for spot in spots
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The signature's own ball, with whichever of a few ratios explains most of what is left.

        Where the drop is more than such a ball can give, a larger one.
        """
        centre_mm, radius_mm = place_of(signature.label)
        largest = drop_of(RATIOS[0], forward.poisson_ratio)
        radius_mm = min(10.0, radius_mm * max(1.0, float(amounts[0]) / largest) ** (1 / 3))
        inside = _inside(forward, centre_mm, radius_mm)
        left = forward.sight.observed(_left(forward))
        grasps = forward.base.grasps
        moved = softened(forward.base, inside, RATIOS)
        lost = []
        for units in zip(*moved, strict=True):
            more = [
                unit - recording.tracks.unit_displacement
                for unit, recording in zip(units, grasps, strict=True)
            ]
            beyond = left - forward.compliance * forward.sight.observed(more)
            lost.append(float(beyond @ beyond))
        place = dict(zip(CENTRE, map(float, centre_mm), strict=True))
        return {**place, RADIUS: radius_mm, RATIO: RATIOS[int(np.argmin(lost))]}

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], choice: str) -> Response:
        """Every recording's markers above flesh with such a ball in it."""
        centre_mm = np.array([parameters[name] for name in CENTRE])
        inside = _inside(forward, centre_mm, parameters[RADIUS])
        return Response(unit=[own[0] for own in softened(forward.base, inside, [parameters[RATIO]])])


EFFECT = SoftSpot()


def label_of(spot: Spot) -> str:
    """Tells one place from another, and is all that is kept of it."""
    x, y, z = spot.centre_mm
    return f"{x:.2f} {y:.2f} {z:.2f} radius {spot.radius_mm:.2f} mm"


def place_of(label: str) -> tuple[Float[np.ndarray, "3"], float]:
    """Centre and radius, mm, of a label."""
    words = label.split()
    return np.array([float(word) for word in words[:3]]), float(words[4])


def _inside(forward: ForwardModel, centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> csr_array:
    mesh, nu = forward.base.mesh, forward.poisson_ratio
    return ball_stiffness(mesh, centre_mm=centre_mm, radius_mm=radius_mm, poisson_ratio=nu)


def _left(forward: ForwardModel) -> list[Float[np.ndarray, "f n 3"]]:
    """What the plain model leaves of the markers' positions (their places and the fruit's motion in it)."""
    tracks = [recording.tracks for recording in forward.base.grasps]
    return [own.position_mm - own.place_mm - forward.compliance * own.unit_displacement for own in tracks]


def _fields(forward: ForwardModel, spot: Spot) -> list[ObservationDelta | None]:
    """What the ball adds to each recording per unit drop; None where it bears next to nothing."""
    inside = _inside(forward, spot.centre_mm, spot.radius_mm)
    moved = to_first_order(forward.base, inside)
    return [None if own is None else ObservationDelta(markers=forward.compliance * own) for own in moved]

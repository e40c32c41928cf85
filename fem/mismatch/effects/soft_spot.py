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

from fem.mismatch.effect import Effect, Response, Signature
from fem.mismatch.effect_spec import EffectSpec, EffectWords, Scope, number, vector
from fem.mismatch.localisation.spot_search import OTHERS, RADII_MM, Spot, best_spots
from fem.mismatch.model.force_products import OfFlesh
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.spot_response import softened, to_first_order
from fem.mismatch.result import Where
from fem.mismatch.signature_variant import AtPlace, Variant
from fem.solid.inclusion import ball_stiffness, drop_of, times

CENTRE = ("centre_mm.0", "centre_mm.1", "centre_mm.2")
RADIUS, RATIO = "radius_mm", "ratio"
MIDDLE_RATIO = 0.35
"""Of the moduli: the spot whose drop is the prior's standard deviation. Set by hand, a plain bruise."""
RATIOS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85)
"""Of the moduli, tried as starts: from next to nothing to next to sound."""

SPEC = EffectSpec(
    name="soft_spot",
    rank=50,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="there is a soft spot, such as a bruise",
        meaning="One place in the flesh is much softer than the rest. It is marked on the fruit below.",
        advice="Look at the fruit there, cut it open if in doubt, and sort it as bruised. The modulus given "
        "afterwards is that of the sound flesh.",
    ),
    parameters=(
        vector(
            "centre_mm",
            "mm",
            "centre of the spot",
            components=3,
            limits=(-1e3, 1e3),
            low=-500.0,
            high=500.0,
            spread=40.0,
            model_sd=0.5,
        ),
        number(
            RADIUS,
            "mm",
            "radius of the spot",
            limits=(1e-3, 1e3),
            low=3.0,
            high=10.0,
            log=True,
            model_share=0.08,
        ),
        number(
            RATIO,
            "1",
            "firmness of the spot over that of the flesh",
            limits=(1e-6, 1e6),
            low=0.05,
            high=0.95,
            model_share=0.12,
        ),
    ),
)
"""By hand, wide: `limits`, `low`, `high`. Measured: `model_sd`, `model_share` (fem.mismatch.effect_spec)."""


@dataclass(frozen=True)
class SoftSpot:
    """The effect; see the module. `radii_mm` and `others`: which signatures it has
    (fem.mismatch.localisation.spot_search).
    """

    spec: EffectSpec = SPEC
    radii_mm: tuple[float, ...] = RADII_MM
    others: int = OTHERS

    def signatures(self, forward: ForwardModel) -> Sequence[Signature]:
        """One for each of the best places."""
        spots = best_spots(
            forward,
            forward.adjoint_basis.observed(_residual(forward)),
            radii_mm=self.radii_mm,
            others=self.others,
        )
        sd = drop_of(MIDDLE_RATIO, forward.poisson_ratio)
        return [
            Signature(
                variant=variant_of(spot),
                columns=(
                    Regressor(
                        name="drop",
                        sd=sd,
                        fields=_fields(forward, spot),
                        positive=True,
                        of_forces=_of_forces(forward, spot),
                    ),
                ),
            )
            for spot in spots
        ]

    def start(
        self, forward: ForwardModel, signature: Signature, amounts: Float[np.ndarray, " k"]
    ) -> dict[str, float]:
        """The signature's own ball, with whichever of a few ratios explains most of what is left.

        Where the drop is more than such a ball can give, a larger one.
        """
        place = signature.variant
        if not isinstance(place, AtPlace):
            raise TypeError(f"{place!r} is no place in the flesh")
        centre_mm, radius_mm = np.array(place.centre_mm), place.radius_mm
        largest = drop_of(RATIOS[0], forward.poisson_ratio)
        radius_mm = min(10.0, radius_mm * max(1.0, float(amounts[0]) / largest) ** (1 / 3))
        inside = _inside(forward, centre_mm, radius_mm)
        residual = forward.adjoint_basis.observed(_residual(forward))
        grasps = forward.base.grasps
        moved = softened(forward.base, inside, RATIOS)
        lost = []
        for units in zip(*moved, strict=True):
            more = [
                unit - recording.tracks.unit_displacement
                for unit, recording in zip(units, grasps, strict=True)
            ]
            remaining = residual - forward.compliance * forward.adjoint_basis.observed(more)
            lost.append(float(remaining @ remaining))
        centre = dict(zip(CENTRE, place.centre_mm, strict=True))
        return {**centre, RADIUS: radius_mm, RATIO: RATIOS[int(np.argmin(lost))]}

    def where(self, parameters: Mapping[str, float]) -> Where:
        """The ball."""
        x, y, z = (parameters[name] for name in CENTRE)
        return Where(region="flesh", centre_mm=(x, y, z), radius_mm=parameters[RADIUS])

    def respond(self, forward: ForwardModel, parameters: Mapping[str, float], variant: Variant) -> Response:
        """Every recording's markers above flesh with such a ball in it."""
        centre_mm = np.array([parameters[name] for name in CENTRE])
        inside = _inside(forward, centre_mm, parameters[RADIUS])
        return Response(
            unit=[by_ratio[0] for by_ratio in softened(forward.base, inside, [parameters[RATIO]])]
        )


EFFECT: Effect = SoftSpot()


def variant_of(spot: Spot) -> AtPlace:
    """The place, to a hundredth of a millimetre."""
    x, y, z = (round(float(component), 2) for component in spot.centre_mm)
    return AtPlace(centre_mm=(x, y, z), radius_mm=round(float(spot.radius_mm), 2))


def _inside(forward: ForwardModel, centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> csr_array:
    mesh, nu = forward.base.mesh, forward.poisson_ratio
    return ball_stiffness(mesh, centre_mm=centre_mm, radius_mm=radius_mm, poisson_ratio=nu)


def _of_forces(forward: ForwardModel, spot: Spot) -> OfFlesh:
    inside = _inside(forward, spot.centre_mm, spot.radius_mm)
    return OfFlesh(lambda recording, moved: times(inside, moved))


def _residual(forward: ForwardModel) -> list[Float[np.ndarray, "_f _n 3"]]:
    """What the plain model leaves of the markers' positions (their places and the fruit's motion in it)."""
    tracks = [recording.tracks for recording in forward.base.grasps]
    return [
        track.position_mm - track.place_mm - forward.compliance * track.unit_displacement for track in tracks
    ]


def _fields(forward: ForwardModel, spot: Spot) -> list[ObservationDelta | None]:
    """What the ball adds to each recording per unit drop; None where it bears next to nothing."""
    inside = _inside(forward, spot.centre_mm, spot.radius_mm)
    moved = to_first_order(forward.base, inside)
    return [
        None if change is None else ObservationDelta(markers=forward.compliance * change) for change in moved
    ]

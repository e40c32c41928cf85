"""`soft_spot`: a ball in the flesh whose modulus is `ratio` times that outside.

    K = K0 - (1 - ratio) K1,      K1 the stiffness of the flesh inside

The equations are solved in the space of fem.mismatch.model.reduced_law. Signature: K0^-1 K1 U0, at the few
places where it best explains the plain model's residual (fem.mismatch.localisation.spot_search). Its amount
is drop_of(ratio), not 1 - ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from fem.materials.strain_path import linear_stress
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.linear_law import matrix_operator, neo_hookean_operator, piecewise_operator
from fem.mismatch.localisation.spot_search import OTHERS, RADII_MM, Spot, best_spots
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.finite_change import finite_change, in_proportion
from fem.mismatch.model.force_noise import OfFlesh
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.model.reduced_law import Operator, ReducedLaw, first_changes, reduced_laws
from fem.mismatch.result import Where
from fem.mismatch.signature_variant import Variant, at_place
from fem.solid.inclusion import ball_stiffness, drop_of, fading

CENTRE = ("centre_mm.0", "centre_mm.1", "centre_mm.2")
RADIUS, RATIO = "radius_mm", "ratio"
MIDDLE_RATIO = 0.35
"""Ratio of moduli whose drop is the prior's standard deviation. Set by hand: a clear bruise."""
RATIOS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85)
"""Ratios of moduli tried as starts: from almost no stiffness to almost undamaged."""
CORRECTIONS = 2
"""Corrections in the reduced space; each new ball requires its own solves."""

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
        EffectParameter(
            "centre_mm",
            "mm",
            "centre of the spot",
            components=3,
            limits=(-1e3, 1e3),
            low=-500.0,
            high=500.0,
            spread=40.0,
        ),
        EffectParameter(
            RADIUS,
            "mm",
            "radius of the spot",
            limits=(1e-3, 1e3),
            low=3.0,
            high=10.0,
            log=True,
        ),
        EffectParameter(
            RATIO,
            "1",
            "firmness of the spot over that of the flesh",
            limits=(1e-6, 1e6),
            low=0.05,
            high=0.95,
        ),
    ),
)
"""Limits and bounds are set by hand, wide."""


@dataclass(frozen=True, kw_only=True)
class SoftSpot(Effect):
    """The effect; see the module. `radii_mm` and `others` select its signatures
    (fem.mismatch.localisation.spot_search).
    """

    radii_mm: tuple[float, ...] = RADII_MM
    others: int = OTHERS

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each of the best places."""
        spots = best_spots(
            model,
            model.adjoint_basis.observed(_residual(model)),
            radii_mm=self.radii_mm,
            others=self.others,
        )
        return [_signature(model, spot) for spot in spots]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The signature's ball, with the one of RATIOS that leaves the smallest residual.

        If the amount exceeds the largest drop of such a ball, the ball is larger.
        """
        *centre_mm, radius_mm = signature.variant.values
        largest = drop_of(RATIOS[0], model.poisson_ratio)
        radius_mm = min(10.0, radius_mm * max(1.0, float(amounts[0]) / largest) ** (1 / 3))
        laws = _laws(model, np.array(centre_mm), radius_mm)
        residual = model.adjoint_basis.observed(_residual(model))
        lost = []
        for ratio in RATIOS:
            more = [
                law.response((1.0, ratio - 1)) - recording.tracks.unit_displacement
                for law, recording in zip(laws, model.grasps, strict=True)
            ]
            remaining = residual - model.compliance * model.adjoint_basis.observed(more)
            lost.append(float(remaining @ remaining))
        return self.spec.within_bounds(*centre_mm, radius_mm, RATIOS[int(np.argmin(lost))])

    def where(self, parameters: Parameters) -> Where:
        """The ball."""
        x, y, z = (parameters[name] for name in CENTRE)
        return Where(region="flesh", centre_mm=(x, y, z), radius_mm=parameters[RADIUS])

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """Place, radius and ratio have those of their bounds."""
        return {}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """Every recording's markers on flesh with such a ball in it; the change of large deformation is that
        of the signature's ball.
        """
        centre_mm = np.array([parameters[name] for name in CENTRE])
        laws = _laws(model, centre_mm, parameters[RADIUS])
        small = [law.response((1.0, parameters[RATIO] - 1)) for law in laws]
        *place_mm, radius_mm = variant.values or at_place(centre_mm, parameters[RADIUS]).values
        first, finite = _changes(model, np.array(place_mm), radius_mm)
        return Response(unit=in_proportion(small, model.plain, first, finite))


EFFECT: Effect = SoftSpot(spec=SPEC)


def _signature(model: CaseModel, spot: Spot) -> Signature:
    variant = at_place(spot.centre_mm, spot.radius_mm)
    *place_mm, radius_mm = variant.values
    centre_mm = np.array(place_mm)
    inside = _inside(model, centre_mm, radius_mm)
    changes = zip(*_changes(model, centre_mm, radius_mm), strict=True)
    return Signature.of_markers(
        "drop",
        [model.compliance * (first + more) for first, more in changes],
        sd=drop_of(MIDDLE_RATIO, model.poisson_ratio),
        variant=variant,
        positive=True,
        of_forces=OfFlesh(lambda recording, moved: inside(moved)),
    )


def _changes(model: CaseModel, centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> tuple[Fields, Fields]:
    """Changes by a unit drop: K0^-1 K1 U0, and what large deformation adds."""

    def at_small_strain() -> Fields:
        inside = _inside(model, centre_mm, radius_mm)
        return first_changes(model, lambda moved: -inside(moved))

    def operators() -> tuple[Operator, Operator]:
        softer = -fading(np.linalg.norm(model.points.point_mm - centre_mm, axis=2), radius_mm)
        linear = partial(linear_stress, poisson_ratio=model.poisson_ratio)
        return neo_hookean_operator(model, softer), piecewise_operator(model, linear, weight=softer)

    key = (SPEC.name, *centre_mm.tolist(), radius_mm)
    first = model.memoised((key, "first"), at_small_strain)
    return first, finite_change(model, key, operators, amount=1.0)


def _laws(model: CaseModel, centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> list[ReducedLaw]:
    inside = _inside(model, centre_mm, radius_mm)
    parts = (matrix_operator(model.stiffness), inside)
    return reduced_laws(model, derivative=inside, parts=parts, corrections=CORRECTIONS)


def _inside(model: CaseModel, centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> Operator:
    """K1 of the ball."""
    mesh, nu = model.mesh, model.poisson_ratio
    return matrix_operator(ball_stiffness(mesh, centre_mm=centre_mm, radius_mm=radius_mm, poisson_ratio=nu))


def _residual(model: CaseModel) -> Fields:
    """The plain model's residual of the markers' positions, with their places and the fruit's motion."""
    return [recording.excess(model.compliance) for recording in model.grasps]

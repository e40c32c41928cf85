"""`third_contact`: an object other than the pads pushes at the fruit; no pad measures that force.

A palm, a table or a stop touches the skin at X. With F(t) its force,

    sum f_i + F = 0, moments likewise,      y(t) = X + s [c(t) + C_X F(t)] + R q(t) + noise

C_X: the markers' response to a force at X, E = 1 MPa. F needs no law: in every frame it balances the pads'
own forces. Springs, rigid stops with late contact, and contacts in some of the recordings alone are therefore
one effect. It requires that the moments too are those of a force through one place of the skin, nearly along
its normal, inwards. The data do not show the support's stiffness: flesh under a contact of 6 mm radius
has a compliance of about 1/(12 mm E), so that a ripe fruit behaves equally on a palm of 5 N/mm and on a
table. Places of the contact and its force: fem.mismatch.kinds.third_force.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.surface_points import SurfacePoints, locate, spread_out
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.third_force import SCALES, ForceBalance, ThirdForce, axes_at, peak_N
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.result import Where
from fem.mismatch.signature_variant import Variant, at_place

CENTRE = ("centre_mm.0", "centre_mm.1", "centre_mm.2")
FORCE = "force_N"
SPACING_MM = 6.0
"""Spacing of the places tried first: a quarter of a fruit's radius, over which a force turns by some 15
degrees. Set by hand, so that the best place is next to one of them."""
FINE_MM = 1.0
"""Spacing of the places tried around the best of these."""
PLACE_SD_MM = 6.0
"""Prior standard deviation of the place about the one that balances best. Two simulated contacts that carry
4 and 1.5 % of the pads' force are 1 and 9 mm off."""
LEAST_EVIDENCE = 20.0
"""Least ln evidence of the balance alone for a third contact to be tried. Simulated contacts that carry 3 %
of the pads' force have more. Cases without one have 18.5 at most, except if a pad is misplaced or drifts, or
if two gels have faults."""
LEAST_N = 1e-3
"""N: less than any sensor's noise."""
SEAT_MM = 4.0
"""Radius over which the force is spread and the normal averaged; the pads are a few times as far away. Set by
hand: a contact as wide as a pad's."""
SPEC = EffectSpec(
    name="third_contact",
    rank=195,
    family="interaction",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="something beside the pads touches the fruit and pushes at it",
        meaning="A palm, a table or a stop bears a part of the load that no pad feels. The place is marked "
        "on the fruit below.",
        advice="Clear what stands there, or lift the fruit off it before the jaws close. Apply the effect to "
        "recordings made so far: the push is then taken from the pads' own forces.",
    ),
    parameters=(
        EffectParameter(
            "centre_mm",
            "mm",
            "place of the contact on the skin",
            components=3,
            limits=(-1e3, 1e3),
            low=-500.0,
            high=500.0,
            spread=PLACE_SD_MM,
        ),
        EffectParameter(
            FORCE,
            "N",
            "its greatest push",
            limits=(0.0, 1e4),
            low=LEAST_N,
            high=100.0,
            log=True,
        ),
    ),
)
"""The scope is the fruit: the place belongs to its skin, and stays there when the jaws grasp the fruit at
other spots. Another fruit on the same palm touches it elsewhere."""


@dataclass(frozen=True, kw_only=True)
class Seat:
    """A place of contact on the skin: middle, unit normal into the fruit, points around it."""

    place_mm: Float[np.ndarray, "3"]
    inward: Float[np.ndarray, "3"]
    points: SurfacePoints

    @classmethod
    def at(cls, mesh: FleshMesh, place_mm: Float[np.ndarray, "3"]) -> "Seat":
        """The seat at the point of the skin nearest to a place."""
        middle = locate(mesh, place_mm[None])
        _, first, second = axes_at(middle.normal[0]).T
        angle = np.arange(6) * np.pi / 3
        ring = SEAT_MM * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
        points = locate(mesh, middle.point_mm + np.vstack([np.zeros(3), ring]))
        inward = -points.normal.mean(axis=0)
        return cls(place_mm=middle.point_mm[0], inward=inward / np.linalg.norm(inward), points=points)

    def unit_loads(self) -> Float[np.ndarray, "3 m 3"]:
        """A newton along x, y and z, spread evenly over the points, on the nodes of the flesh."""
        count = len(self.points.point_mm)
        return self.points.point_load(np.repeat(np.eye(3)[:, None] / count, count, axis=1))


@dataclass(frozen=True, kw_only=True)
class PlacedContact:
    """A third contact, with its force in each recording. `search`: ln of the ratio of the mean evidence over
    all places to that of the best place; zero or less.
    """

    seat: Seat
    forces: tuple[ThirdForce | None, ...]
    search: float = 0.0

    @property
    def greatest_N(self) -> tuple[float, float]:
        """The greatest normal force, LEAST_N at least, and its standard deviation."""
        pushes = [
            (float(normal.max()), float(force.sd_N[normal.argmax()]))
            for force in self.forces
            if force is not None
            for normal in [force.force_N @ self.seat.inward]
        ]
        value, sd = max(pushes, default=(0.0, 1.0))
        return max(value, LEAST_N), sd

    def changes(
        self, model: CaseModel
    ) -> list[tuple[Float[np.ndarray, "_f _n 3"], Float[np.ndarray, "_f 6"]] | None]:
        """Changes of each recording's unit displacement and sums of force; None without a force."""
        changes: list[tuple[Float[np.ndarray, "_f _n 3"], Float[np.ndarray, "_f 6"]] | None] = []
        place = self.seat.place_mm
        for recording, force in zip(model.grasps, self.forces, strict=True):
            if force is None:
                changes.append(None)
                continue
            at_markers = model.memoised(
                ("third contact", recording.case.name, tuple(np.round(place, 6))),
                partial(_pushed, recording, self.seat.unit_loads()),
            )
            at_place = np.broadcast_to(place, (len(force.force_N), 1, 3))
            sums = recording.wrench(force.force_N[:, None], at_place)
            changes.append((np.tensordot(force.force_N, at_markers, axes=1), -sums))
        return changes


def _pushed(recording: GraspResponse, loads: Float[np.ndarray, "r m 3"]) -> Float[np.ndarray, "r n 3"]:
    return recording.at_markers(recording.solid.displacement(loads))


class ThirdContact(Effect):
    """The effect; see the module."""

    seen_directly = True

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """The force at the place that balances best, if any. The amount is the greatest force as a share of
        a pad's peak force.
        """
        contact = best_contact(model)
        if contact is None:
            return []
        share = contact.greatest_N[0] / max(peak_N(recording) for recording in model.grasps)
        fields = [
            None
            if change is None
            else ObservationDelta(markers=model.compliance * change[0] / share, balance=change[1] / share)
            for change in contact.changes(model)
        ]
        column = Regressor(name="push", sd=SCALES[-1], fields=fields, positive=True)
        return [Signature(variant=at_place(contact.seat.place_mm, SEAT_MM), columns=(column,))]

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The place that balances best, and the measured force."""
        contact = best_contact(model)
        push_N = LEAST_N if contact is None else contact.greatest_N[0]
        return self.spec.within_bounds(*signature.variant.values[:3], push_N)

    def direct_evidence(self, model: CaseModel) -> float:
        """Cost of estimating force and place from the balance: negative."""
        contact = best_contact(model)
        if contact is None:
            return 0.0
        return contact.search + sum(force.volume for force in contact.forces if force is not None)

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """PLACE_SD_MM about the starting place; the measured force."""
        contact = best_contact(model)
        value, sd = (LEAST_N, LEAST_N) if contact is None else contact.greatest_N
        place = zip(CENTRE, signature.variant.values[:3], strict=True)
        return {
            **{name: Prior(x, PLACE_SD_MM, measured=True) for name, x in place},
            FORCE: Prior(value, sd / value, measured=True),
        }

    def where(self, parameters: Parameters) -> Where:
        """The place on the skin."""
        x, y, z = (parameters[name] for name in CENTRE)
        return Where(region="skin", centre_mm=(x, y, z), radius_mm=SEAT_MM)

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """Every recording under the force at this place that balances it."""
        seat = Seat.at(model.mesh, np.array([parameters[name] for name in CENTRE]))
        contact = PlacedContact(seat=seat, forces=_forces(model, seat.place_mm, seat.inward))
        unit, balance = [], []
        for recording, change in zip(model.grasps, contact.changes(model), strict=True):
            plain = recording.tracks.unit_displacement
            unit.append(plain if change is None else plain + change[0])
            balance.append(np.zeros((len(plain), 6)) if change is None else change[1])
        return Response(unit=unit, balance=balance)


EFFECT: Effect = ThirdContact(spec=SPEC)


def best_contact(model: CaseModel) -> PlacedContact | None:
    """The place whose force balances best, memoised for the case; None if evidence is too low."""
    return model.memoised("third contact", lambda: _searched(model))


def _searched(model: CaseModel) -> PlacedContact | None:
    if _most_evidence(model) < LEAST_EVIDENCE:
        return None
    mesh = model.mesh
    skin_mm = mesh.nodes_mm[mesh.outer_nodes]
    places, evidence = _evidence(model, skin_mm[spread_out(skin_mm, apart_mm=SPACING_MM)])
    mean = float(logsumexp(evidence) - np.log(len(evidence)))
    best = places[int(np.argmax(evidence))]
    along = axes_at(Seat.at(mesh, best).inward)[:, 1:]
    step = np.arange(-SPACING_MM, SPACING_MM + FINE_MM, FINE_MM)
    offsets = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    finer, finer_evidence = _evidence(model, best + offsets @ along.T)
    seat = Seat.at(mesh, finer[int(np.argmax(finer_evidence))])
    forces = _forces(model, seat.place_mm, seat.inward)
    greatest = sum(force.evidence for force in forces if force is not None)
    if greatest <= LEAST_EVIDENCE:
        return None
    return PlacedContact(seat=seat, forces=forces, search=mean - max(*evidence, greatest))


def _most_evidence(model: CaseModel) -> float:
    """Half of the imbalance's chi-square: the upper bound of any force's gain."""
    balances = [model.balance_equations(recording) for recording in model.grasps]
    return sum(
        float((balance.measured * balance.weighed(balance.measured)).sum()) / 2
        for balance in balances
        if balance is not None
    )


def _evidence(
    model: CaseModel, places_mm: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "p 3"], list[float]]:
    """The points of the skin nearest to these places, and ln evidence of a force at each."""
    skin = locate(model.mesh, places_mm)
    evidence = [
        sum(force.evidence for force in _forces(model, place, -normal) if force is not None)
        for place, normal in zip(skin.point_mm, skin.normal, strict=True)
    ]
    return skin.point_mm, evidence


def _forces(
    model: CaseModel, place_mm: Float[np.ndarray, "3"], inward: Float[np.ndarray, "3"]
) -> tuple[ThirdForce | None, ...]:
    """Force in each recording; None if it has none, or if not only pads hold the fruit."""

    def balance(recording: GraspResponse) -> ForceBalance | None:
        equations = model.balance_equations(recording)
        return None if equations is None else ForceBalance.of(recording, equations)

    balances = model.memoised("third contact's balances", lambda: model.each(balance))
    return tuple(None if known is None else known.force(place_mm, inward) for known in balances)

"""`loose_pit`: freestone. A uniform gap separates flesh and pit; pressure closes it, without friction.

Without a pit the flesh responds linearly to the measured forces f and to pressures p on its inner surface. At
every patch of that surface, with u_n its displacement out of the pit and v_n the rigid pit's,

    gap / s + u_n(f, p) - v_n >= 0,      p >= 0,      p (gap / s + u_n - v_n) = 0,      pit in equilibrium

for E = 1 MPa: Signorini's conditions (Kikuchi and Oden 1988, Contact Problems in Elasticity). The response
depends on the present forces alone. These conditions describe a pit that turns until almost no moment acts on
it. A pit that friction holds does not turn. Under oblique load around an oblong pit, the displacement beyond
that of bonded flesh is up to three times as large if the pit turns, hence both variants. Signature: this
response minus the bonded one, for a few gaps and both variants, amount 1. Small gaps have this amount too: an
amount below LEAST_AMOUNT indicates something else.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from fem.elements.shape_functions import TET_FACES, t6_gradient, t6_shape, tri_quadrature
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.surface_points import spread_out
from fem.mesh.tetrahedra import boundary_faces
from fem.mismatch.effect import Amounts, Effect, Parameters, Prior, Response, Signature
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields, GraspResponse
from fem.mismatch.signature_variant import Variant, significant
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.rigid_core import pit_centre_mm, rigid_modes
from fem.solid.unilateral_contact import pressures

GAP = "gap_mm"
GAPS_MM = (0.03, 0.06, 0.1, 0.15, 0.21, 0.28, 0.36, 0.48)
"""Gaps of the signatures, mm, at the plain model's 1/E: each 30 to 100 % wider than the one before, since
responses change in proportion."""
MOST_FRAMES = 30
"""Frames of a recording at which contact is solved, evenly spaced in load, with linear interpolation."""
PEAK = 0.3
"""Contact is also solved at peaks of the load above this share of the greatest."""
LEAST_AMOUNT = 0.5
"""Set between fitted amounts of the gap that gains most: at most 0.44 for eight fruit without mismatch, 0.69
to 1.02 for the six inspected of eight loose pits drawn for it. All are development cases."""
MOST_ROUNDS, STILL = 12, 1e-3
"""Contact depends on the gap over 1/E, which differs from the bonded model's 1/E. Rounds solve contact and
fit 1/E until its relative change is below STILL (a tenth of E's uncertainty)."""

SPEC = EffectSpec(
    name="loose_pit",
    rank=100,
    family="object",
    scope=Scope.FRUIT,
    words=EffectWords(
        short="the pit is loose in its hollow",
        meaning="There is a gap between flesh and pit (a freestone): the flesh gives way easily at first, "
        "until it meets the pit.",
        advice="Nothing is wrong with the fruit. Read the modulus with the gap taken out.",
    ),
    parameters=(
        EffectParameter(
            GAP,
            "mm",
            "gap between flesh and pit",
            limits=(0.0, 50.0),
            low=0.005,
            high=1.0,
            log=True,
        ),
    ),
    of_the_pit=True,
)
"""Limits and bounds are set by hand, wide."""


class LoosePit(Effect):
    """The effect; see the module."""

    def signatures(self, model: CaseModel) -> Sequence[Signature]:
        """One for each gap, for a pit that turns and one that does not; none if the flesh has no pit.

        Contact is solved for a gap over 1/E. The fit of 1/E comes afterwards and gives the gap in mm.
        """
        if not len(model.mesh.pit_nodes):
            return []
        signatures = []
        for pit_turns, gap_mm in product((True, False), GAPS_MM):
            try:
                unit = _responses(model, gap_mm / model.compliance, pit_turns=pit_turns)
            except FemFailure as failure:
                way = at_gap(gap_mm, pit_turns=pit_turns)
                signatures.append(Signature(variant=way, columns=(), untried=failure.detail))
                continue
            share = _fitted(model, unit) / model.compliance
            way = at_gap(significant(gap_mm * share, 3), pit_turns=pit_turns)
            column = Response(unit=unit).column(model, "loose", sd=1.0, positive=True, least=LEAST_AMOUNT)
            signatures.append(Signature(variant=way, columns=(column,)))
        return signatures

    def start(self, model: CaseModel, signature: Signature, amounts: Amounts) -> dict[str, float]:
        """The signature's own gap; its amount is the fitted 1/E over the plain model's."""
        return self.spec.within_bounds(signature.variant.values[0])

    def prior(self, model: CaseModel, signature: Signature) -> dict[str, Prior]:
        """The gap has that of its bounds."""
        return {}

    def respond(self, model: CaseModel, parameters: Parameters, variant: Variant) -> Response:
        """Response of flesh that touches its pit where it is pressed on it.

        If the variant does not state whether the pit turns (ONE_WAY, of settings), both are computed and the
        one that fits the recordings better is used. Raises FemFailure if neither can be computed.
        """
        gap_mm = parameters[GAP]
        if variant.pit_turns is not None:
            return Response(unit=self._fixed_point(model, gap_mm, pit_turns=variant.pit_turns))
        responses: list[Fields] = []
        failures: list[FemFailure] = []
        for turns in (True, False):
            try:
                responses.append(self._fixed_point(model, gap_mm, pit_turns=turns))
            except FemFailure as failure:
                failures.append(failure)
        if not responses:
            raise failures[0]
        return Response(unit=max(responses, key=lambda unit: _explained(model, unit)))

    @staticmethod
    def _fixed_point(model: CaseModel, gap_mm: float, *, pit_turns: bool) -> Fields:
        compliance = model.compliance
        for _ in range(MOST_ROUNDS):
            unit, before = _responses(model, gap_mm / compliance, pit_turns=pit_turns), compliance
            compliance = _fitted(model, unit)
            if abs(compliance / before - 1) < STILL:
                return unit
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"1/E of flesh about a pit with a gap of {gap_mm:.3g} mm still changes by "
            f"{abs(compliance / before - 1):.2%} after {MOST_ROUNDS} rounds, expected {STILL:.1%} at most",
        )


EFFECT: Effect = LoosePit(spec=SPEC)


def at_gap(gap_mm: float, *, pit_turns: bool) -> Variant:
    """Variant of a gap around the pit, the start of the search, and of whether the pit turns."""
    label = f"gap {gap_mm:g} mm, pit {'turns' if pit_turns else 'does not turn'}"
    return Variant(label=label, values=(gap_mm,), pit_turns=pit_turns)


def _responses(model: CaseModel, gap: float, *, pit_turns: bool) -> Fields:
    """Responses of all recordings, mm MPa, for a `gap` in mm MPa."""
    return model.each(lambda recording: loose_response(model, recording, gap, pit_turns=pit_turns))


def loose_response(
    model: CaseModel, recording: GraspResponse, gap: float, *, pit_turns: bool
) -> Float[np.ndarray, "f n 3"]:
    """The markers' displacement, mm MPa, for a `gap` in mm MPa."""
    flesh = loose_flesh(model, recording)
    key = ("loose answer", recording.case.name)
    free, opening, pushed = model.memoised(key, lambda: flesh.marker_response(recording))
    open_by = recording.shares @ opening + gap * flesh.area_mm2
    path, frames = _spread(recording.shares)
    contact_pressure = pressures(flesh.compliance(pit_turns=pit_turns), open_by[frames])
    pressed = np.stack([np.interp(path, path[frames], course) for course in contact_pressure.T], axis=1)
    return np.asarray(recording.whole(free) + np.tensordot(pressed, pushed, axes=(1, 0)))


def _spread(
    shares: Float[np.ndarray, "f r"],
) -> tuple[Float[np.ndarray, " f"], Int[np.ndarray, " k"]]:
    """Path length of the load at each frame; indices of frames evenly spaced along it, and of its peaks."""
    step = np.linalg.norm(np.diff(shares, axis=0), axis=1) + 1e-12
    path = np.concatenate([[0.0], np.cumsum(step)])
    even = np.searchsorted(path, np.linspace(0, path[-1], MOST_FRAMES))
    size = np.linalg.norm(shares, axis=1)
    rim = np.concatenate([[-np.inf], size, [-np.inf]])
    peaks = np.flatnonzero((size >= rim[:-2]) & (size >= rim[2:]) & (size > PEAK * size.max()))
    return path, np.union1d(even.clip(max=len(path) - 1), peaks)


def _fitted(model: CaseModel, unit: Fields) -> float:
    """1/E fitted with this unit response."""
    along, plain = model.compliance_products(unit)
    return max(along / plain, model.compliance / 10)


def _explained(model: CaseModel, unit: Fields) -> float:
    """Decrease of the markers' chi-square by this unit response at its best 1/E."""
    along, plain = model.compliance_products(unit)
    return max(along, 0.0) ** 2 / plain


MOST_PATCHES = 200
"""Patches of the pit's surface, with one solve each; about 3 mm apart on a nectarine's pit. Set by hand."""
AT_ONCE = 50
"""Right-hand sides solved together; affects memory only."""
HELD_N_PER_MM = 1e-3
"""Stiffness (at E = 1 MPa) of the springs that prevent free translation of the pit."""
TURNING_SHARE = 0.02
"""Rotational stiffness of a pit that is free to turn, N mm per rad, as a share of E r^3 (r: its mean radius;
bonded in flesh it is 8 pi G r^3 = 8.7 E r^3). Without it an almost round pit would turn by radians to move by
tenths of a millimetre, while the linear kinematics hold for angles below about 0.1. Set by hand, similar to
the samples' (8 N mm per rad, whatever E). It matters for slightly oblong pits. Example: semi-axes 10.5, 9.5
and 10 mm, an oblique load of 9 N at 1 MPa. With a third of this stiffness, with it (0.11 rad) and with three
times as much, flesh is softer by 21, 17 and 14 %, and by 11 % if the pit does not turn. The model does not
return the moment of this spring, or that on a pit that does not turn, to the flesh as friction. For a fixed
pit of 12, 9 and 15 mm this changes the softening by 4 % of it."""


@dataclass(frozen=True, kw_only=True)
class LooseFlesh:
    """Compliances for E = 1 MPa. `shifting`: openings (times area) under pressures, with the pit's shift;
    `turning`: what its turning adds to them; `skin`: the skin's displacement under each pressure.
    """

    solid: UnitModulusSolid
    load: csr_array
    area_mm2: Float[np.ndarray, " c"]
    shifting: Float[np.ndarray, "c c"]
    turning: Float[np.ndarray, "c c"]
    skin: Float[np.ndarray, "c o 3"]

    @classmethod
    def of(cls, bonded: UnitModulusSolid) -> "LooseFlesh":
        """The same flesh and support without the pit: one more factorisation and one solve per patch."""
        mesh = bonded.mesh
        solid = UnitModulusSolid.factorise(
            replace(mesh, pit_nodes=np.zeros(0, dtype=mesh.pit_nodes.dtype)),
            poisson_ratio=bonded.poisson_ratio,
            support=bonded.support,
            parts=bonded.parts,
        )
        load, area = patches(mesh)
        count = load.shape[1]
        skin = np.empty((count, len(bonded.contact_nodes), 3))
        compliance = np.empty((count, count))
        for start in range(0, count, AT_ONCE):
            these = slice(start, min(start + AT_ONCE, count))
            moved = solid.displacement(_as_loads(load[:, these]))
            skin[these] = moved[:, bonded.contact_nodes]
            compliance[these] = (load.T @ moved.reshape(len(moved), -1).T).T
        shift, turn = _pit_gives(mesh, load)
        return cls(
            solid=replace(solid, contact_nodes=bonded.contact_nodes),
            load=load,
            area_mm2=area,
            shifting=(compliance + compliance.T) / 2 + shift,
            turning=turn,
            skin=skin,
        )

    def compliance(self, *, pit_turns: bool) -> Float[np.ndarray, "c c"]:
        """Openings (times area) under pressures, for a pit that turns or does not."""
        return self.shifting + self.turning if pit_turns else self.shifting

    def marker_response(
        self, recording: GraspResponse
    ) -> tuple[Float[np.ndarray, "r n 3"], Float[np.ndarray, "r c"], Float[np.ndarray, "c n 3"]]:
        """Displacements of markers and openings of patches (times area) under a recording's patterns without
        inner pressure; displacements of markers under each patch's pressure."""
        moved = self.solid.displacement(recording.loads(recording.patterns))
        opening = (self.load.T @ moved.reshape(len(moved), -1).T).T
        return recording.at_markers(moved), opening, recording.seen(self.skin)


def loose_flesh(model: CaseModel, recording: GraspResponse) -> LooseFlesh:
    """The flesh with this recording's support, computed once."""
    support = recording.case.support
    return model.memoised(("loose flesh", support), lambda: LooseFlesh.of(recording.solid))


def patches(mesh: FleshMesh) -> tuple[csr_array, Float[np.ndarray, " c"]]:
    """Nodal loads B (3 n, c) of unit pressures; patches' areas, mm2."""
    faces = inner_faces(mesh)
    points, weights = tri_quadrature()
    x = mesh.nodes_mm[faces]
    slope = np.einsum("qdn,knx->kqdx", t6_gradient(points), x)
    normal = np.cross(slope[:, :, 1], slope[:, :, 0])  # out of the pit; its length is the area element
    hats = np.column_stack([1 - points.sum(axis=1), points])
    pushes = np.einsum("q,qa,qh,kqx->khax", weights, t6_shape(points), hats, normal)
    spread = np.einsum("q,qh,kq->kh", weights, hats, np.linalg.norm(normal, axis=2))
    corners, place = np.unique(faces[:, :3], return_inverse=True)
    corner_mm = mesh.nodes_mm[corners]
    chosen = spread_out(corner_mm, most=MOST_PATCHES)
    patch = np.asarray(cKDTree(corner_mm[chosen]).query(corner_mm)[1])[place].reshape(-1, 3)
    rows = np.broadcast_to(3 * faces[:, None, :, None] + np.arange(3), pushes.shape)
    columns = np.broadcast_to(patch[:, :, None, None], pushes.shape)
    shape = (3 * len(mesh.nodes_mm), int(patch.max()) + 1)
    load = coo_array((pushes.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()
    return load, np.bincount(patch.ravel(), weights=spread.ravel())


def inner_faces(mesh: FleshMesh) -> Int[np.ndarray, "k 6"]:
    """T6 faces around the pit, their normals out of the flesh."""
    _, whose = boundary_faces(mesh.tets[:, :4])
    tet, side = whose.T
    faces = mesh.tets[tet[:, None], TET_FACES[side]]
    return np.asarray(faces[np.isin(faces, mesh.pit_nodes).all(axis=1)])


def _pit_gives(mesh: FleshMesh, load: csr_array) -> tuple[Float[np.ndarray, "c c"], Float[np.ndarray, "c c"]]:
    """Compliances that the pit's shift and turning add to the openings, by virtual work: H H' / stiffness."""
    pit = mesh.nodes_mm[mesh.pit_nodes]
    centre = pit_centre_mm(mesh.nodes_mm, mesh.pit_nodes)
    radius_mm = float(np.linalg.norm(pit - centre, axis=1).mean())
    push = load.T @ rigid_modes(mesh.nodes_mm, centre_mm=centre).reshape(-1, 6)
    shift, turn = push[:, :3], push[:, 3:]
    return shift @ shift.T / HELD_N_PER_MM, turn @ turn.T / (TURNING_SHARE * radius_mm**3)


def _as_loads(columns: csr_array) -> Float[np.ndarray, "f n 3"]:
    dense = columns.toarray().T
    return np.ascontiguousarray(dense).reshape(len(dense), -1, 3)

"""Flesh that is not bonded to its pit: how its inner surface and skin move under loads and pressures.

The inner surface is covered by c patches, hat functions phi_j of its corner nodes gathered to at most
MOST_PATCHES. A pressure p_j on patch j is the nodal load B_j p_j, the patch's mean normal displacement
B_j' u / a_j, with

    B_j = integral of N phi_j n,        a_j = integral of phi_j,        n: out of the pit, into the flesh

so that both do the same work. The pit is rigid: under pressures it shifts until they balance, hanging in
springs so weak that they carry next to nothing and are there for when nothing touches it. Whether it turns as
well, as a smooth one does, or friction and fibres hold it, is not known beforehand: there is a compliance of
each.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from fem.elements.shape_functions import TET_FACES, t6_gradient, t6_shape, tri_quadrature
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.surface_points import spread_out
from fem.mesh.tetrahedra import boundary_faces
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import GraspResponse
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.rigid_core import pit_centre_mm, rigid_modes

MOST_PATCHES = 200
"""On the pit's surface: a solution each, about 3 mm apart on a nectarine's pit. Set by hand."""
AT_ONCE = 50
"""Right-hand sides solved together: memory, nothing else."""
HELD_N_PER_MM = 1e-3
"""Stiffness (at E = 1 MPa) of the springs that keep the pit from floating off."""
TURNING_SHARE = 0.02
"""Stiffness against turning of a pit that is free to turn, N mm per rad, as a share of E r^3 (r: its mean
radius; bonded in flesh it is 8 pi G r^3 = 8.7 E r^3). Without it a pit that is almost round would turn by
radians to give way by tenths of a millimetre, where motions are linear for angles below about 0.1. Set by
hand, of the size of the samples' own (8 N mm per rad, whatever E). It matters for pits that are a little
oblong: one of semi-axes 10.5, 9.5 and 10 mm, pressed askew by 9 N at 1 MPa, makes flesh softer by 21, 17 and
14 % with a third of it, with it (0.11 rad) and with three times as much, by 11 % if it does not turn. The
moment of this spring, and that on a pit that does not turn, is not given back to the flesh as friction: that
changes how much softer flesh is about a held pit of 12, 9 and 15 mm by 4 % of it."""


@dataclass(frozen=True, kw_only=True)
class LooseFlesh:
    """`shifting`: openings (times area) under pressures, the pit's shift included; `turning`: what its
    turning adds to them; `skin`: the skin's displacement under each pressure; all for E = 1 MPa.
    """

    solid: UnitModulusSolid
    load: csr_array
    area_mm2: Float[np.ndarray, " c"]
    shifting: Float[np.ndarray, "c c"]
    turning: Float[np.ndarray, "c c"]
    skin: Float[np.ndarray, "c o 3"]

    @classmethod
    def of(cls, bonded: UnitModulusSolid) -> "LooseFlesh":
        """The same flesh, held alike, without its pit: one more factorisation and one solve per patch."""
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
        """Openings (times area) under pressures, about a pit that turns or does not."""
        return self.shifting + self.turning if pit_turns else self.shifting

    def marker_response(
        self, recording: GraspResponse
    ) -> tuple[Float[np.ndarray, "r n 3"], Float[np.ndarray, "r c"], Float[np.ndarray, "c n 3"]]:
        """Under a recording's patterns: its markers and the patches (times area) with no pressure inside; and
        the markers under each patch's pressure."""
        moved = self.solid.displacement(recording.loads(recording.patterns))
        opening = (self.load.T @ moved.reshape(len(moved), -1).T).T
        return recording.at_markers(moved), opening, recording.seen(self.skin)


def loose_flesh(model: CaseModel, recording: GraspResponse) -> LooseFlesh:
    """The flesh of this recording's support, made once."""
    support = recording.case.support
    return model.memoised(("loose flesh", support), lambda: LooseFlesh.of(recording.solid))


def patches(mesh: FleshMesh) -> tuple[csr_array, Float[np.ndarray, " c"]]:
    """B (3 n, c) and the patches' areas, mm2."""
    faces = inner_faces(mesh)
    points, weights = tri_quadrature()
    x = mesh.nodes_mm[faces]
    slope = np.einsum("qdn,knx->kqdx", t6_gradient(points), x)
    normal = np.cross(slope[:, :, 1], slope[:, :, 0])  # out of the pit; its length is the area's
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
    """T6 faces round the pit, their normals out of the flesh."""
    _, whose = boundary_faces(mesh.tets[:, :4])
    tet, side = whose.T
    faces = mesh.tets[tet[:, None], TET_FACES[side]]
    return np.asarray(faces[np.isin(faces, mesh.pit_nodes).all(axis=1)])


def _pit_gives(mesh: FleshMesh, load: csr_array) -> tuple[Float[np.ndarray, "c c"], Float[np.ndarray, "c c"]]:
    """What the pit's shift and its turning add to the openings, by work: H H' / stiffness."""
    pit = mesh.nodes_mm[mesh.pit_nodes]
    centre = pit_centre_mm(mesh.nodes_mm, mesh.pit_nodes)
    radius_mm = float(np.linalg.norm(pit - centre, axis=1).mean())
    push = load.T @ rigid_modes(mesh.nodes_mm, centre_mm=centre).reshape(-1, 6)
    shift, turn = push[:, :3], push[:, 3:]
    return shift @ shift.T / HELD_N_PER_MM, turn @ turn.T / (TURNING_SHARE * radius_mm**3)


def _as_loads(columns: csr_array) -> Float[np.ndarray, "f n 3"]:
    dense = columns.toarray().T
    return np.ascontiguousarray(dense).reshape(len(dense), -1, 3)

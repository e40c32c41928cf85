"""Link of one pad's markers to the contact nodes of a fruit: sparse maps of force and displacement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, kron

from fem.grasp_history import GraspHistory, PadHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.surface_points import SurfacePoints, locate
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.traction import marker_weights, moment_correction

OFF_SKIN_MM = 3.0
"""Markers farther than this from the skin of the mesh are a failure: registration has put them on the
surface."""


@dataclass(frozen=True)
class PadLink:
    """One pad's markers on a solid's contact nodes.

    Nodal forces are L f = `plain` f + `rigid` (`balance` f) (fem.solid.traction, assembled on the nodes),
    dofs node by node. The transpose gives displacements, L' u: the mean over the skin that carries a marker's
    force. So forces do the same work on either side, f (L' u) = (L f) u. L preserves force and moment, so L'
    is exact for rigid motions, and the traction's sharpening makes it exact to second order elsewhere. The
    displacement at the markers' own points would be 13 % too low on the rim of a hard pad, where the traction
    is steepest, and with it E by 3 %.
    """

    place: SurfacePoints
    skin: SurfacePoints
    weights: csr_array
    plain: csr_array
    rigid: Float[np.ndarray, "d 6"]
    balance: Float[np.ndarray, "6 m"]

    def nodal_force(self, force_N: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f c 3"]:
        """Forces on the contact nodes; total force and moment are the markers' own."""
        flat = force_N.reshape(len(force_N), -1).T
        nodal = self.plain @ flat + self.rigid @ (self.balance @ flat)
        return np.ascontiguousarray(nodal.T).reshape(len(force_N), -1, 3)

    def at_markers(self, displacement: Float[np.ndarray, "f c 3"]) -> Float[np.ndarray, "f m 3"]:
        """Displacement of the markers by that of the contact nodes."""
        flat = displacement.reshape(len(displacement), -1).T
        read = self.plain.T @ flat + self.balance.T @ (self.rigid.T @ flat)
        return np.ascontiguousarray(read.T).reshape(len(displacement), -1, 3)


@dataclass(frozen=True)
class PadPlaces:
    """Where one pad's markers, and the points that carry their traction, lie on the skin of a mesh; `weights`
    are the points' shares of the markers' forces.
    """

    place: SurfacePoints
    skin: SurfacePoints
    weights: csr_array

    @property
    def nodes(self) -> Int[np.ndarray, " c"]:
        """The skin nodes that the pad loads or reads, sorted."""
        return np.unique(np.concatenate([self.place.face_nodes, self.skin.face_nodes]))


def pad_places(pad: PadHistory, mesh: FleshMesh) -> PadPlaces:
    """Located on the mesh; raises FemFailure (off-surface)."""
    place = locate(mesh, pad.surface_mm, within_mm=OFF_SKIN_MM)
    between, weights = marker_weights(pad.rest_mm, place.point_mm)
    return PadPlaces(place, locate(mesh, between, within_mm=OFF_SKIN_MM), weights)


def contact_nodes(mesh: FleshMesh, histories: Sequence[GraspHistory]) -> Int[np.ndarray, " c"]:
    """The skin nodes that these grasps load or read, sorted; raises FemFailure (off-surface)."""
    nodes = [np.zeros(0, dtype=np.int64)]
    for history in histories:
        nodes += [pad_places(pad, mesh).nodes for pad in history.pads]
    return np.unique(np.concatenate(nodes))


def pad_link(pad: PadHistory, solid: UnitModulusSolid) -> PadLink:
    """The link of one pad's markers to the solid; raises FemFailure (off-surface)."""
    return linked(pad_places(pad, solid.mesh), solid)


def slid(link: PadLink, solid: UnitModulusSolid, way_mm: Float[np.ndarray, "3"]) -> PadLink:
    """The same pad shifted slightly along the skin, to first order."""
    mesh = solid.mesh
    moved = PadPlaces(link.place.slid(mesh, way_mm), link.skin.slid(mesh, way_mm), link.weights)
    return linked(moved, solid)


def linked(at: PadPlaces, solid: UnitModulusSolid) -> PadLink:
    """The maps between marker forces and nodes, from the places of markers and skin points."""
    place, skin, weights = at.place, at.skin, at.weights
    rigid, balance = moment_correction(skin.point_mm, place.point_mm, weights)
    spread = skin.among(solid.contact_nodes).interpolation.T.tocsr()
    return PadLink(
        place=place,
        skin=skin,
        weights=weights,
        plain=csr_array(kron(spread @ weights, np.eye(3), format="csr")),
        rigid=(spread @ rigid.reshape(skin.point_mm.shape[0], -1)).reshape(-1, 6),
        balance=balance,
    )

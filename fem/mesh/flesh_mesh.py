"""From closed surfaces of fruit and pit to a T10 mesh of the flesh between them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fem.elements.shape_functions import (
    TET_FACES,
    t6_gradient,
    t6_shape,
    t10_gradient,
    tet_quadrature,
    tri_quadrature,
)
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.boundary_fit import pull, t4_jacobians, t10_jacobians
from fem.mesh.closed_surface import Surface, checked_surface, must_enclose, must_lie_on, split_boundary
from fem.mesh.closest_point import TriangleSearch
from fem.mesh.creases import corner_targets, middle_targets
from fem.mesh.local_refinement import affordable_size, bisected
from fem.mesh.tetrahedra import boundary_faces, with_mid_edges
from fem.mesh.tetwild import fill, simplified

#: edges in a contact, and how far around it they stay as short, as shares of its width
EDGE_SHARE, RADIUS_SHARE = 0.2, 0.1
#: edges in a contact of any size, mm
SHORTEST_MM, LONGEST_MM = 0.2, 1.7
#: points closer than this, or than this many times the usual distance to the next one, share a contact
GAP_MM, GAPS = 3.0, 1.5


def contact_size(
    points_mm: Float[np.ndarray, "q 3"],
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Edge length wanted at each contact point, and the distance from it up to which it is: both in mm.

    Points that lie together make one contact. Its width is the least extent along the surface; a single
    point or a line counts as 1 mm wide.
    """
    width = np.empty(len(points_mm))
    contact = _together(points_mm)
    for k in range(contact.max() + 1):
        width[contact == k] = _width_mm(points_mm[contact == k])
    return np.clip(EDGE_SHARE * width, SHORTEST_MM, LONGEST_MM), RADIUS_SHARE * width


def _together(points_mm: Float[np.ndarray, "q 3"]) -> np.ndarray:
    """A number for each point, the same for those that chains of short gaps join."""
    tree = cKDTree(points_mm)
    apart = np.asarray(tree.query(points_mm, k=[min(2, len(points_mm))])[0])
    reach = max(GAP_MM, GAPS * float(np.median(apart)))
    pairs = tree.query_pairs(reach, output_type="ndarray")
    near = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=2 * (len(points_mm),))
    return np.asarray(connected_components(near, directed=False)[1])


def _width_mm(points_mm: Float[np.ndarray, "q 3"]) -> float:
    """The least extent in any direction along the plane of the points (to 2 %), at least 1 mm."""
    off = points_mm - points_mm.mean(axis=0)
    plane = np.linalg.svd(off, full_matrices=True)[2][:2]
    turn = np.radians(np.arange(0, 180, 2))
    extent = np.ptp(off @ (np.column_stack([np.cos(turn), np.sin(turn)]) @ plane).T, axis=0)
    return max(float(extent.min()), 1.0)


QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
"""Nodes of the four flat triangles that stand for a T6."""
#: largest relative change of the fruit's or the pit's volume that a mesh may bring
VOLUME_TOLERANCE = 3e-3
#: how far from the points refine_at_mm edges stay refine_edge_mm long, where only the latter is given
RADIUS_MM = 2.0
#: longest edges, as a share of the cube root of the fruit's volume
LARGEST_SHARE = 1 / 8
#: edges where the pit is sharp, as a share of those elsewhere: strain is singular there
CREASE_SHARE = 0.4
#: edges on the pit, and how far the mesher may stray from the surfaces it is given, as shares of edge_mm
PIT_SHARE, ENVELOPE_SHARE = 0.65, 0.025


@dataclass(frozen=True)
class FleshMesh:
    """Quadratic tetrahedra of the flesh; what the pit fills is a hole, bounded by the pit's nodes.

    tets: corners 0..3, then mid-edges 01, 12, 20, 03, 13, 23. outer_faces: T6 (corners, mid-edges 01, 12, 20)
    with outward normals. pit_nodes: every node of the pit's surface, sorted; empty without a pit.
    """

    nodes_mm: Float[np.ndarray, "n 3"]
    tets: Int[np.ndarray, "m 10"]
    outer_faces: Int[np.ndarray, "k 6"]
    pit_nodes: Int[np.ndarray, " p"]

    @cached_property
    def volume_mm3(self) -> float:
        """Volume of the flesh, by quadrature over the curved elements."""
        points, weights = tet_quadrature()
        slope = np.einsum("qin,mnx->mqix", t10_gradient(points), self.nodes_mm[self.tets])
        return float((np.linalg.det(slope) @ weights).sum())

    @cached_property
    def outer_nodes(self) -> Int[np.ndarray, " o"]:
        """Every node of the skin, sorted."""
        return np.unique(self.outer_faces)

    @cached_property
    def pit_share(self) -> Float[np.ndarray, " n"]:
        """One on the pit, zero on the skin, between them in proportion to each node's distances to both."""
        to_pit = cKDTree(self.nodes_mm[self.pit_nodes]).query(self.nodes_mm)[0]
        to_skin = cKDTree(self.nodes_mm[self.outer_nodes]).query(self.nodes_mm)[0]
        return np.asarray(to_skin / (to_skin + to_pit))

    @cached_property
    def skin_search(self) -> TriangleSearch:
        """The skin's faces cut in four flat triangles each (QUARTERS), face by face, to look for closest
        points on.
        """
        return TriangleSearch.of(self.nodes_mm, self.outer_faces[:, QUARTERS].reshape(-1, 3))


def tetrahedralise(
    outer_vertices: Float[np.ndarray, "v 3"],
    outer_faces: Int[np.ndarray, "f 3"],
    pit_vertices: Float[np.ndarray, "w 3"] | None,
    pit_faces: Int[np.ndarray, "g 3"] | None,
    *,
    edge_mm: float,
    refine_at_mm: Float[np.ndarray, "q 3"] | None = None,
    refine_radius_mm: float | Float[np.ndarray, " q"] | None = None,
    refine_edge_mm: float | Float[np.ndarray, " q"] | None = None,
    dof_limit: int = 60_000,
) -> FleshMesh:
    """The flesh between a fruit's surface and its pit's as T10 elements about edge_mm long.

    Never longer than an eighth of the cube root of the volume, so that a cherry is resolved like a peach,
    and 0.4 of that on sharp edges of the pit. Within refine_radius_mm of the points refine_at_mm edges are
    about refine_edge_mm, growing gently beyond; both follow the width of the contact that the points cover
    where neither is given (fem.mesh.flesh_mesh): cover it. Both may be given for each point. All these are
    longer where the mesh would otherwise exceed dof_limit degrees of freedom (three a node).
    Boundary nodes lie on the surfaces as given, not on the mesher's simplification of them. Both volumes are
    measured against the surfaces' own. Two runs give meshes alike, not the same ones (see fem.mesh.tetwild).

    Raises FemFailure: BAD_SURFACE, NOT_WATERTIGHT, PIT_OUTSIDE_FRUIT, OFF_SURFACE (points to refine at),
    MESHING_FAILED, DISCONNECTED_FLESH, INVERTED_ELEMENTS, VOLUME_LOST; each says what was found, and where.
    """
    outer = checked_surface(outer_vertices, outer_faces, name="fruit")
    edge_mm = min(edge_mm, LARGEST_SHARE * outer.volume_mm3 ** (1 / 3))
    if refine_at_mm is not None and len(refine_at_mm):
        must_lie_on(outer, refine_at_mm, within_mm=2 * edge_mm)
    skin = simplified(outer.vertices_mm, outer.faces, edge_mm=edge_mm)
    pit, surfaces = None, [skin]
    if pit_vertices is not None and pit_faces is not None:
        pit = checked_surface(pit_vertices, pit_faces, name="pit")
        v, f = simplified(pit.vertices_mm, pit.faces, edge_mm=PIT_SHARE * edge_mm)
        must_enclose(skin, v, thinnest_mm=2 * ENVELOPE_SHARE * edge_mm)
        surfaces.append((v, f[:, ::-1]))
    nodes, tets = fill(surfaces, edge_mm=edge_mm, envelope_mm=ENVELOPE_SHARE * edge_mm)
    nodes = _on_surfaces(nodes, tets, np.arange(len(nodes)), outer, pit)
    where = _fine_places(pit, edge_mm, refine_at_mm, refine_edge_mm, refine_radius_mm)
    return _refined(nodes, tets, outer, pit, *where, dof_limit=dof_limit)


def refined(
    mesh: FleshMesh,
    outer_vertices: Float[np.ndarray, "v 3"],
    outer_faces: Int[np.ndarray, "f 3"],
    pit_vertices: Float[np.ndarray, "w 3"] | None,
    pit_faces: Int[np.ndarray, "g 3"] | None,
    *,
    edge_mm: float,
    refine_at_mm: Float[np.ndarray, "q 3"],
    refine_edge_mm: float | None = None,
    dof_limit: int,
) -> FleshMesh:
    """A mesh of `tetrahedralise` with smaller elements in the contacts, to another dof_limit.

    The other arguments are those of the mesh. Raises FemFailure: BAD_SURFACE, NOT_WATERTIGHT,
    INVERTED_ELEMENTS, VOLUME_LOST.
    """
    outer = checked_surface(outer_vertices, outer_faces, name="fruit")
    edge_mm = min(edge_mm, LARGEST_SHARE * outer.volume_mm3 ** (1 / 3))
    pit = None
    if pit_vertices is not None and pit_faces is not None:
        pit = checked_surface(pit_vertices, pit_faces, name="pit")
    corners, tets = np.unique(mesh.tets[:, :4], return_inverse=True)
    where = _fine_places(pit, edge_mm, refine_at_mm, refine_edge_mm, None)
    nodes = mesh.nodes_mm[corners]
    return _refined(nodes, tets.reshape(-1, 4), outer, pit, *where, dof_limit=dof_limit)


def _refined(
    nodes: np.ndarray,
    tets: np.ndarray,
    outer: Surface,
    pit: Surface | None,
    at_mm: np.ndarray,
    edge_mm: np.ndarray,
    radius_mm: np.ndarray,
    *,
    dof_limit: int,
) -> FleshMesh:
    """The T10 mesh with edges about edge_mm long around the points at_mm, if dof_limit allows."""
    if len(at_mm):
        size = affordable_size(nodes, tets, at_mm, radius_mm=radius_mm, edge_mm=edge_mm, dof_limit=dof_limit)
        nodes, tets = bisected(
            nodes, tets, size, settle=lambda moved, cut, new: _on_surfaces(moved, cut, new, outer, pit)
        )
    return _quadratic(nodes, tets, outer, pit)


def _fine_places(
    pit: Surface | None,
    edge_mm: float,
    touched_mm: np.ndarray | None,
    refine_edge_mm: float | Float[np.ndarray, " q"] | None,
    refine_radius_mm: float | Float[np.ndarray, " q"] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that need short edges, how short, and how far around: the pit's creases, and the contacts."""
    at = np.empty((0, 3))
    if pit is not None and len(pit.creases.start_mm):
        at = pit.creases.points_mm(apart_mm=CREASE_SHARE * edge_mm)
    edge, radius = np.full(len(at), CREASE_SHARE * edge_mm), np.zeros(len(at))
    if touched_mm is None or not len(touched_mm):
        return at, edge, radius
    short, near = contact_size(touched_mm)
    if refine_edge_mm is not None:
        short, near = np.full(len(short), refine_edge_mm), np.full(len(short), RADIUS_MM)
    if refine_radius_mm is not None:
        near = np.full(len(short), refine_radius_mm)
    return np.vstack([at, touched_mm]), np.concatenate([edge, short]), np.concatenate([radius, near])


def _on_surfaces(
    nodes: np.ndarray, tets: np.ndarray, candidates: np.ndarray, outer: Surface, pit: Surface | None
) -> np.ndarray:
    """Corner nodes among the candidates that lie on the boundary, pulled to the surface they belong to."""
    skin, inner = split_boundary(nodes, boundary_faces(tets)[0], with_pit=pit is not None)
    for faces, surface in ((skin, outer), (inner, pit)):
        moving = np.intersect1d(faces, candidates)
        if surface is not None and len(moving):
            sharp, place = corner_targets(nodes, faces, moving, surface.creases)
            moving = np.setdiff1d(moving, sharp)
            place = np.vstack([place, surface.closest(nodes[moving])])
            nodes = pull(nodes, tets, np.concatenate([sharp, moving]), place, t4_jacobians)
    return nodes


def _quadratic(nodes: np.ndarray, tets: np.ndarray, outer: Surface, pit: Surface | None) -> FleshMesh:
    """Mid-edge nodes, the boundary as T6 faces, checked: shape and volumes hold."""
    n_corners = len(nodes)
    nodes, tets10 = with_mid_edges(nodes, tets)
    owner, face = boundary_faces(tets)[1].T
    faces6 = tets10[owner[:, None], TET_FACES[face]]
    skin, inner = split_boundary(nodes, faces6, with_pit=pit is not None)
    for faces, surface in ((skin, outer), (inner, pit)):
        moving = np.unique(faces)
        moving = moving[moving >= n_corners]
        if surface is not None:
            sharp, place = middle_targets(nodes, faces, surface.creases)
            moving = np.setdiff1d(moving, sharp)
            place = np.vstack([place, surface.closest(nodes[moving])])
            nodes = pull(nodes, tets10, np.concatenate([sharp, moving]), place, t10_jacobians)
    jacobians = t10_jacobians(nodes, tets10)
    lowest = jacobians.min(axis=1) / np.abs(jacobians).max(axis=1)
    folded = jacobians.min(axis=1) <= 0
    if folded.any():
        worst = int(lowest.argmin())
        where = ", ".join(f"{x:.1f}" for x in nodes[tets10[worst]].mean(axis=0))
        raise FemFailure(
            FemProblem.INVERTED_ELEMENTS,
            f"{folded.sum()} of {len(tets10)} elements are inverted, the worst near ({where}) mm "
            f"(ratio of smallest to largest Jacobian {lowest[worst]:.2g}, expected above zero). Use a "
            "finer mesh or smooth the surface there",
        )
    mesh = FleshMesh(nodes, tets10, skin, np.unique(inner))
    _check_volumes(mesh, inner, outer, pit)
    return mesh


def _check_volumes(mesh: FleshMesh, inner: np.ndarray, outer: Surface, pit: Surface | None) -> None:
    """Raise VOLUME_LOST where the mesh holds another fruit or pit than the surfaces do."""
    pit_found = t6_volume_mm3(mesh.nodes_mm, inner[:, [0, 2, 1, 5, 4, 3]]) if len(inner) else 0.0
    volumes_mm3 = {"fruit": mesh.volume_mm3 + pit_found, "pit": pit_found}
    for name, surface in (("fruit", outer), ("pit", pit)):
        if surface is not None and abs(volumes_mm3[name] / surface.volume_mm3 - 1) > VOLUME_TOLERANCE:
            raise FemFailure(
                FemProblem.VOLUME_LOST,
                f"the {name} has {volumes_mm3[name]:.0f} mm3 in the mesh but {surface.volume_mm3:.0f} mm3 "
                f"in its surface, a difference above {VOLUME_TOLERANCE:.1%}. Use a finer mesh or "
                "smooth the surface",
            )


def t6_volume_mm3(nodes_mm: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 6"]) -> float:
    """Volume inside a closed T6 surface with outward normals: one third of the flux of x through it."""
    points, weights = tri_quadrature()
    x = nodes_mm[faces] - nodes_mm[faces].mean(axis=(0, 1))
    place = np.einsum("qn,knx->kqx", t6_shape(points), x)
    tangent = np.einsum("qin,knx->kqix", t6_gradient(points), x)
    normal = np.cross(tangent[:, :, 0], tangent[:, :, 1])
    return float((np.einsum("kqx,kqx->kq", place, normal) @ weights).sum() / 3)

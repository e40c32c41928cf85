"""What finer elements under a load would add to a displacement: one subdomain of a two-level method.

A mesh is too stiff under a load that covers few of its elements. There its elements are cut in two until they
are short enough, so that the finer space holds the coarser one and the body keeps its shape to the last digit
(children are mapped by their parent's own shape functions). With u of the coarse mesh, P its interpolation to
the finer nodes, F the same load on these, the error e of u follows from

    K e = F - K P u       on the subdomain, e = 0 where it is cut from the rest of the body and on the pit.

What it leaves out decays with the distance from the load (Saint-Venant), as the loads F - K P u do no work on
any displacement of the coarse mesh, but for the body forces that balance a free body's load (left out here:
0.1 % of what is added under a disc with 1 N). Source: Smith, Bjorstad and Gropp, "Domain Decomposition",
1996, section 2.1 (one subdomain's correction).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array, eye_array
from scipy.spatial import cKDTree

from fem.elements.assembly import assemble
from fem.elements.shape_functions import TET_FACES, t10_shape
from fem.mesh.flesh_mesh import QUARTERS, FleshMesh
from fem.mesh.local_refinement import bisected, size_near
from fem.mesh.surface_points import locate
from fem.mesh.tetrahedra import boundary_faces, compact, with_mid_edges
from fem.sparse.solver import Factor, factorise

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Corners of a tetrahedron's face, by the corner opposite to it."""
CANDIDATES = 60
"""Elements among which a child's parent is looked for first, by their middles."""
INSIDE = -1e-7
"""Least barycentric coordinate of a child's middle in its parent, with rounding."""
MOST = 0.8
"""Share of the body's elements that a subdomain holds at most."""
HELD = 1e-9
"""Share of nodes that move in a finer node's displacement, with rounding, below which it is held."""
ON_SKIN_MM = 1e-3
"""Points of the skin farther than this from the subdomain's lie beyond it."""


@dataclass(frozen=True, kw_only=True)
class FinerElements:
    """The flesh around a load in shorter elements.

    `mesh`: the subdomain, its skin the part of the body's that belongs to it. `from_coarse` (n N): values on
    the whole body's nodes to its own. `free`: the nodes that are not held, on the cut or on the pit.
    """

    mesh: FleshMesh
    from_coarse: csr_array
    free: Int[np.ndarray, " f"]
    stiffness: csr_array
    factor: Factor

    def added(
        self, force_N: Float[np.ndarray, "r n 3"], coarse: Float[np.ndarray, "r N 3"]
    ) -> Float[np.ndarray, "r n 3"]:
        """e at the subdomain's nodes, mm MPa, of loads on them and the whole body's displacement by these."""
        given = np.moveaxis(coarse, 0, 1).reshape(coarse.shape[1], -1)
        moved = (self.from_coarse @ given).reshape(-1, len(coarse), 3)
        moved = np.moveaxis(moved, 1, 2).reshape(-1, len(coarse))
        dofs = (3 * self.free[:, None] + np.arange(3)).ravel()
        left = force_N.reshape(len(force_N), -1).T - self.stiffness @ moved
        displacement = np.zeros_like(left)
        displacement[dofs] = self.factor.solve(left[dofs])
        return np.ascontiguousarray(displacement.T).reshape(force_N.shape)

    def reading(self, points_mm: Float[np.ndarray, "p 3"]) -> csr_array:
        """Sparse (p, n): nodal values to values at points of the body's skin; zero at those beyond the
        subdomain's.
        """
        skin = self.mesh.nodes_mm[self.mesh.outer_faces[:, :3]]
        longest = np.linalg.norm(skin - np.roll(skin, 1, axis=1), axis=2).max()
        near = cKDTree(skin.reshape(-1, 3)).query(points_mm)[0] < longest
        if not near.any():
            return csr_array((len(points_mm), len(self.mesh.nodes_mm)))
        places = locate(self.mesh, points_mm[near])
        within = diags_array((places.distance_mm < ON_SKIN_MM).astype(float))
        spread = eye_array(len(points_mm), format="csr")[:, np.flatnonzero(near)]
        return csr_array(spread @ within @ places.interpolation)


def finer_elements(
    mesh: FleshMesh,
    at_mm: Float[np.ndarray, "q 3"],
    *,
    edge_mm: float,
    reach_mm: float,
    poisson_ratio: float,
    held: Int[np.ndarray, " h"],
) -> FinerElements:
    """The elements whose middles are within `reach_mm` of the loaded points, edges about `edge_mm` at these.

    Edges grow with the distance from the points as in fem.mesh.local_refinement. Elements that touch a loaded
    face belong in any case; a share of the body never does (MOST), so that something holds the rest. `held`:
    nodes of the whole body that do not move.
    """
    middle = mesh.nodes_mm[mesh.tets[:, :4]].mean(axis=1)
    distance = cKDTree(at_mm).query(middle)[0]
    loaded = mesh.outer_faces[mesh.skin_search.closest(at_mm).face // len(QUARTERS)]
    near = (distance < reach_mm) | np.isin(mesh.tets, loaded).any(axis=1)
    parents = mesh.tets[near & (distance < np.quantile(distance, MOST))]
    corners, coarse = compact(mesh.nodes_mm, parents[:, :4])
    nodes, tets = bisected(corners, coarse, size_near(at_mm, radius_mm=0.0, edge_mm=edge_mm))
    straight, tets = with_mid_edges(nodes, tets)
    parent = _parents(straight[tets[:, :4]].mean(axis=1), corners[coarse])
    place = _barycentric(straight[tets], corners[coarse[parent]])
    first = np.unique(tets, return_index=True)[1]
    element, node = np.divmod(first, tets.shape[1])
    shape = t10_shape(place[element, node, 1:])
    of_parent = parents[parent[element]]
    rows = np.repeat(np.arange(len(straight)), shape.shape[1])
    from_coarse = coo_array(
        (shape.ravel(), (rows, of_parent.ravel())), shape=(len(straight), len(mesh.nodes_mm))
    ).tocsr()
    faces, on_skin = _boundary(mesh, tets, place, parents[parent])
    finer = FleshMesh(
        nodes_mm=from_coarse @ mesh.nodes_mm,
        tets=tets,
        outer_faces=faces[on_skin],
        pit_nodes=np.zeros(0, dtype=np.int64),
    )
    others = np.setdiff1d(np.arange(len(mesh.nodes_mm)), held)
    moves = np.asarray(abs(from_coarse[:, others]).sum(axis=1)).ravel() > HELD
    free = np.setdiff1d(np.flatnonzero(moves), faces[~on_skin])
    stiffness = assemble(finer.nodes_mm, tets).for_unit_modulus(poisson_ratio=poisson_ratio)
    dofs = (3 * free[:, None] + np.arange(3)).ravel()
    return FinerElements(
        mesh=finer,
        from_coarse=from_coarse,
        free=free,
        stiffness=stiffness,
        factor=factorise(csr_array(stiffness[dofs][:, dofs])),
    )


def _parents(
    middle_mm: Float[np.ndarray, "m 3"], corners_mm: Float[np.ndarray, "k 4 3"]
) -> Int[np.ndarray, " m"]:
    """The straight element that holds each point; all are looked at where none of the nearest does."""
    count = min(CANDIDATES, len(corners_mm))
    near = np.asarray(cKDTree(corners_mm.mean(axis=1)).query(middle_mm, k=np.arange(1, count + 1))[1])
    parent = near[:, 0].copy()
    lost = np.arange(len(middle_mm))
    for choice in range(count):
        tried = near[lost, choice]
        inside = _barycentric(middle_mm[lost, None], corners_mm[tried])[:, 0].min(axis=1) > INSIDE
        parent[lost[inside]] = tried[inside]
        lost = lost[~inside]
        if not len(lost):
            break
    for point in lost:
        within = _barycentric(np.broadcast_to(middle_mm[point], (len(corners_mm), 1, 3)), corners_mm)
        parent[point] = within[:, 0].min(axis=1).argmax()
    return parent


def _barycentric(
    points_mm: Float[np.ndarray, "m p 3"], corners_mm: Float[np.ndarray, "m 4 3"]
) -> Float[np.ndarray, "m p 4"]:
    """Coordinates of points in straight elements."""
    first_mm = corners_mm[:, :1]
    sides, way = corners_mm[:, 1:] - first_mm, points_mm - first_mm
    rest = np.linalg.solve(sides.swapaxes(1, 2), way.swapaxes(1, 2)).swapaxes(1, 2)
    return np.concatenate([1 - rest.sum(axis=2, keepdims=True), rest], axis=2)


def _boundary(
    mesh: FleshMesh,
    tets: Int[np.ndarray, "m 10"],
    place: Float[np.ndarray, "m 10 4"],
    of_parent: Int[np.ndarray, "m 10"],
) -> tuple[Int[np.ndarray, "b 6"], Bool[np.ndarray, " b"]]:
    """The subdomain's outer faces, and which of them lie on the body's skin."""
    owner, face = boundary_faces(tets[:, :4])[1].T
    faces = tets[owner[:, None], TET_FACES[face]]
    across = np.abs(place[owner[:, None], TET_FACES[face, :3]]).max(axis=1)
    opposite = across.argmin(axis=1)
    of_face = np.sort(of_parent[owner[:, None], OTHERS[opposite]], axis=1)
    skin = {tuple(corners) for corners in np.sort(mesh.outer_faces[:, :3], axis=1).tolist()}
    return faces, np.array([tuple(corners) in skin for corners in of_face.tolist()])

"""Bookkeeping of tetrahedra: signed volumes, edges, the boundary and its pieces, mid-edge nodes."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fem.elements.shape_functions import TET_EDGES, TET_FACES


def signed_volumes_mm3(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> Float[np.ndarray, " m"]:
    """Volumes, positive where corner 3 lies on the side to which the normal of 0, 1, 2 points."""
    a, b, c, d = np.moveaxis(nodes_mm[tets], 1, 0)
    return np.asarray(np.einsum("mx,mx->m", np.cross(b - a, c - a), d - a) / 6)


def boundary_faces(tets: Int[np.ndarray, "m 4"]) -> tuple[Int[np.ndarray, "k 3"], Int[np.ndarray, "k 2"]]:
    """Faces that belong to one tetrahedron only, normals outward, and (tetrahedron, which of its faces)."""
    faces = tets[:, TET_FACES[:, :3]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    alone = np.sort(first[count == 1])
    return faces[alone], np.stack([alone // 4, alone % 4], axis=1)


def pieces(cells: Int[np.ndarray, "m c"], n_nodes: int) -> Int[np.ndarray, " m"]:
    """A number for each cell, the same for cells that hang together through shared nodes."""
    i = np.repeat(cells[:, 0], cells.shape[1] - 1)
    j = cells[:, 1:].ravel()
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(n_nodes, n_nodes))
    return np.unique(connected_components(graph, directed=False)[1][cells[:, 0]], return_inverse=True)[1]


def pair_keys(ends: Int[np.ndarray, "*p 2"]) -> Int[np.ndarray, "*p"]:
    """A number for each pair of nodes, which ascends as the pairs do."""
    return np.asarray(ends[..., 0].astype(np.int64) << 32 | ends[..., 1])


def unique_edges(
    cells: Int[np.ndarray, "m c"], local: Int[np.ndarray, "e 2"]
) -> tuple[np.ndarray, np.ndarray]:
    """All edges once, as sorted node pairs (u, 2), and for each cell the numbers of its edges (m, e)."""
    ends = np.sort(cells[:, local], axis=2).reshape(-1, 2)
    _, first, inverse = np.unique(pair_keys(ends), return_index=True, return_inverse=True)
    return ends[first], inverse.reshape(len(cells), len(local))


def with_mid_edges(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "m 10"]]:
    """The T10 mesh on the same straight edges: one node more in the middle of each."""
    edges, of_tet = unique_edges(tets, TET_EDGES)
    return np.vstack([nodes_mm, nodes_mm[edges].mean(axis=1)]), np.hstack([tets, of_tet + len(nodes_mm)])


def compact(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without nodes that no tetrahedron uses."""
    used, renumbered = np.unique(tets, return_inverse=True)
    return nodes_mm[used], renumbered.reshape(tets.shape)

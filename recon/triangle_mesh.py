"""Triangle meshes: edges, volume, normals. Vertices in mm, faces counter-clockwise from outside."""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu

Vertices = Float[np.ndarray, "n 3"]
Faces = Int[np.ndarray, "m 3"]
Mesh = tuple[Float[np.ndarray, "_n 3"], Int[np.ndarray, "_m 3"]]
"""Vertices and faces of a mesh, of any number."""


def sides_of(faces: Faces) -> Int[np.ndarray, "m3 2"]:
    """Ends of the faces' sides: all first sides (corners 0 and 1), then all second, then all third."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)


def open_edges(faces: Faces) -> int:
    """Number of directed edges that repeat or lack their opposite: 0 if closed and oriented, 1 without faces.

    >>> tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> open_edges(tetrahedron), open_edges(tetrahedron[1:])
    (0, 3)
    """
    if len(faces) == 0:
        return 1
    edges = sides_of(faces)
    width = int(edges.max()) + 1
    ahead, count = np.unique(edges[:, 0] * width + edges[:, 1], return_counts=True)
    back = edges[:, 1] * width + edges[:, 0]
    return int((count > 1).sum() + (~np.isin(back, ahead)).sum())


def unique_edges(faces: Faces) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, " m3"]]:
    """Each edge once (lower vertex first, ascending), and the index of each of `sides_of` among them."""
    sides = np.sort(sides_of(faces), axis=1)
    width = int(sides.max(initial=0)) + 1
    keys, of_side = np.unique(sides[:, 0] * width + sides[:, 1], return_inverse=True)
    return np.stack(np.divmod(keys, width), axis=1), of_side


def bodies(faces: Faces) -> int:
    """Number of connected pieces of the surface, which share no vertex."""
    used, index = np.unique(faces, return_inverse=True)
    return int(parts_of(sides_of(index.reshape(faces.shape)), len(used)).max(initial=-1)) + 1


def parts_of(edges: Int[np.ndarray, "e 2"], count: int) -> Int[np.ndarray, " n"]:
    """Index, from 0, of the connected part that contains each of `count` vertices."""
    graph = sparse.coo_array((np.ones(len(edges), np.int8), tuple(edges.T)), shape=(count, count))
    return np.asarray(sparse.csgraph.connected_components(graph, directed=False)[1])


def used_part(vertices: Vertices, faces: Faces) -> Mesh:
    """The mesh without vertices that no face uses."""
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], np.asarray(renumbered).reshape(faces.shape)


def volume_mm3(vertices: Vertices, faces: Faces) -> float:
    """Enclosed volume, sum of a . (b x c) / 6 over the faces; positive for outward faces.

    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> round(6 * volume_mm3(corners, tetrahedron), 12)
    1.0
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def face_areas(vertices: Vertices, faces: Faces) -> Float[np.ndarray, " m"]:
    """Areas of the faces, mm^2."""
    return np.asarray(np.linalg.norm(_crosses(vertices, faces), axis=1) / 2)


def vertex_areas(vertices: Vertices, faces: Faces) -> Float[np.ndarray, " n"]:
    """A third of the areas of each vertex's faces, mm^2."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3, 3), len(vertices))


def vertex_normals(vertices: Vertices, faces: Faces) -> Float[np.ndarray, "n 3"]:
    """Unit normals at the vertices, faces weighted by area."""
    flat = _crosses(vertices, faces)
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(flat[:, k], 3), len(vertices)) for k in range(3)], axis=1
    )
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12))


def _crosses(vertices: Vertices, faces: Faces) -> Float[np.ndarray, "m 3"]:
    """Normals of the faces; their length is twice the area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def facing(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], place: Float[np.ndarray, "3"]
) -> Float[np.ndarray, " n"]:
    """Cosines of the angles between the normals and the directions to a camera at `place`."""
    ray = place - points
    return np.asarray(np.einsum("ij,ij->i", ray, normals) / np.linalg.norm(ray, axis=1))


def rim_crossings(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    i: Int[np.ndarray, " e"],
    j: Int[np.ndarray, " e"],
    place: Float[np.ndarray, "3"],
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Edges with just one end facing a camera at `place`. a (from `i`) and b (from `j`) are the ends. At the
    share t of the way from a to b, n . (place - x) is zero, if linear along the edge.
    """
    towards = np.einsum("ij,ij->i", place - points, normals)
    crossing = (towards[i] > 0) != (towards[j] > 0)
    a, b = i[crossing], j[crossing]
    return a, b, towards[a] / (towards[a] - towards[b])


def smoothed(values: Float[np.ndarray, "n ..."], faces: Faces, rounds: int) -> Float[np.ndarray, "n ..."]:
    """Values at vertices, moved halfway to the mean over their neighbours, `rounds` times."""
    mean = neighbour_mean(faces, len(values))
    for _ in range(rounds):
        values = 0.5 * (values + mean @ values)
    return values


def neighbour_mean(faces: Faces, count: int) -> sparse.csr_array:
    """Matrix that maps values at `count` vertices to the mean over each one's neighbours."""
    i, j = sides_of(faces).T
    A = sparse.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(count, count))
    A.data[:] = 1.0
    return sparse.csr_array(sparse.diags(1 / np.asarray(A.sum(1)).ravel()) @ A)


def solved(
    matrix: sparse.sparray | sparse.spmatrix, right: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """matrix^-1 right for a symmetric positive definite matrix (SuperLU, minimum-degree order)."""
    A, options = sparse.csc_array(matrix), {"SymmetricMode": True}
    factor = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.asarray(factor.solve(right))

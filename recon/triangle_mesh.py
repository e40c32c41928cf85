"""Facts of triangle meshes: closed or not, volume, normals. Vertices in mm, faces counter-clockwise from
outside.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse


def open_edges(faces: Int[np.ndarray, "m 3"]) -> int:
    """How many directed edges lack their opposite or occur twice; 0 for a closed, consistently turned
    manifold.

    >>> tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> open_edges(tetrahedron), open_edges(tetrahedron[1:])
    (0, 3)
    """
    if len(faces) == 0:
        return 1
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    width = int(edges.max()) + 1
    ahead, count = np.unique(edges[:, 0] * width + edges[:, 1], return_counts=True)
    back = edges[:, 1] * width + edges[:, 0]
    return int((count > 1).sum() + (~np.isin(back, ahead)).sum())


def unique_edges(
    faces: Int[np.ndarray, "m 3"],
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, " m3"]]:
    """Each edge once, its lower vertex first, in ascending order; and which of them each side of each face
    is: all first sides (corners 0 and 1), then all second, then all third.
    """
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    sides = sides.astype(np.int64)  # their products overflow 32 bits
    width = int(sides.max(initial=0)) + 1
    keys, of_side = np.unique(sides[:, 0] * width + sides[:, 1], return_inverse=True)
    return np.stack(np.divmod(keys, width), axis=1), of_side


def bodies(faces: Int[np.ndarray, "m 3"]) -> int:
    """How many pieces the surface has that share no vertex."""
    used, index = np.unique(faces, return_inverse=True)
    corner = index.reshape(faces.shape)
    ends = (np.concatenate([corner[:, 0], corner[:, 1]]), np.concatenate([corner[:, 1], corner[:, 2]]))
    graph = sparse.coo_array((np.ones(len(ends[0]), np.int8), ends), shape=(len(used), len(used)))
    return int(sparse.csgraph.connected_components(graph, directed=False)[0])


def consistently_oriented(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "m 3"]:
    """The faces, some of them turned round, so that neighbours run along their shared edge in opposite
    directions; unchanged where an edge has not two faces, or the surface has one side (a Moebius strip).

    Each face has two copies, as it is and turned. Copies that agree along an edge are joined; what is joined
    to the first face's own copy agrees with it.
    """
    m = len(faces)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    low, high = ends.min(axis=1), ends.max(axis=1)
    _, of_side, count = np.unique(
        low * (int(ends.max(initial=0)) + 1) + high, return_inverse=True, return_counts=True
    )
    if m == 0 or (count != 2).any():
        return faces
    sides = np.argsort(of_side, kind="stable").reshape(-1, 2)
    i, j = (sides % m).T
    against = (ends[sides[:, 0], 0] == ends[sides[:, 1], 0]).astype(np.int64)
    rows = np.concatenate([i, i + m])
    columns = np.concatenate([j + m * against, j + m * (1 - against)])
    graph = sparse.coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * m, 2 * m))
    part = sparse.csgraph.connected_components(graph, directed=False)[1]
    as_they_are, turned = part[:m], part[m:]
    if (as_they_are == turned).any():
        return faces
    flipped = as_they_are > turned  # of the two halves of each body, one has the lower number
    return np.where(flipped[:, None], faces[:, ::-1], faces)


def volume_mm3(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> float:
    """Sum of a . (b x c) / 6 over the faces; positive when they look outward.

    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> round(6 * volume_mm3(corners, tetrahedron), 12)
    1.0
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def face_areas(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
    """Areas of the faces, mm^2."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def vertex_normals(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """Unit normals at the vertices, faces weighted by area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(flat[:, k], 3), len(vertices)) for k in range(3)], axis=1
    )
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12))


def facing(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], place: Float[np.ndarray, "3"]
) -> Float[np.ndarray, " n"]:
    """Cosines between the normals and the way to a camera at `place`."""
    ray = place - points
    return np.asarray(np.einsum("ij,ij->i", ray, normals) / np.linalg.norm(ray, axis=1))


def rim_crossings(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    i: Int[np.ndarray, " e"],
    j: Int[np.ndarray, " e"],
    place: Float[np.ndarray, "3"],
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Edges (i, j) whose one end faces a camera at `place` and whose other does not: their ends a and b, and
    the share t of the way from a to b where n . (place - x), linear along the edge, is zero.
    """
    towards = np.einsum("ij,ij->i", place - points, normals)
    crossing = (towards[i] > 0) != (towards[j] > 0)
    a, b = i[crossing], j[crossing]
    return a, b, towards[a] / (towards[a] - towards[b])


def neighbour_mean(faces: Int[np.ndarray, "m 3"], count: int) -> sparse.csr_array:
    """The matrix that takes values at `count` vertices to the mean over each one's neighbours."""
    i = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    i = np.concatenate([i, i[:, ::-1]])
    A = sparse.csr_array((np.ones(len(i)), (i[:, 0], i[:, 1])), shape=(count, count))
    A.data[:] = 1.0
    return sparse.csr_array(sparse.diags(1 / np.asarray(A.sum(1)).ravel()) @ A)

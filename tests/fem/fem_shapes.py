"""Shapes that tests mesh: ellipsoids, and an uneven cube of T10 made without the mesher."""

import numpy as np
from scipy.spatial import ConvexHull

from fem.elements.shape_functions import TET_FACES
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.tetrahedra import boundary_faces, signed_volumes_mm3, with_mid_edges


def ball(n_points: int, *, semi_axes_mm, centre_mm=(0.0, 0.0, 0.0)):
    """An ellipsoid's surface on a Fibonacci spiral of points, triangulated by its convex hull."""
    k = np.arange(n_points) + 0.5
    height, turn = 1 - 2 * k / n_points, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - height**2)
    unit = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    faces = ConvexHull(unit).simplices.astype(np.int64)
    a, b, c = np.moveaxis(unit[faces], 1, 0)
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return unit * np.asarray(semi_axes_mm) + np.asarray(centre_mm), faces


def cube_mesh(n: int, *, uneven: float = 0.25, seed: int = 0, bulge: float = 0.0):
    """A unit cube of T10, n cells an edge; corners off by up to `uneven` cells, mid-edges by `bulge`."""
    rng = np.random.default_rng(seed)
    axis = np.arange(n + 1) / n
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = ((nodes > 1e-9) & (nodes < 1 - 1e-9)).all(axis=1)
    nodes[inside] += rng.uniform(-uneven, uneven, (inside.sum(), 3)) / n
    corner = np.array(
        [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]]
    )
    kuhn = np.array([[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]])
    cell = np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), axis=-1).reshape(-1, 1, 3) + corner
    number = cell @ np.array([(n + 1) ** 2, n + 1, 1])
    tets = number[:, kuhn].reshape(-1, 4)
    backward = signed_volumes_mm3(nodes, tets) < 0
    tets[backward] = tets[backward][:, [0, 2, 1, 3]]
    n_corners = len(nodes)
    nodes, tets = with_mid_edges(nodes, tets)
    inside = ((nodes > 1e-9) & (nodes < 1 - 1e-9)).all(axis=1)
    inside[:n_corners] = False
    nodes[inside] += rng.uniform(-bulge, bulge, (inside.sum(), 3)) / n
    return nodes, tets


def cube_flesh(n: int, size_mm: float = 1.0, **uneven) -> FleshMesh:
    """The cube as flesh without a pit."""
    nodes, tets = cube_mesh(n, **uneven)
    owner, face = boundary_faces(tets[:, :4])[1].T
    return FleshMesh(
        size_mm * nodes, tets, tets[owner[:, None], TET_FACES[face]], np.zeros(0, dtype=np.int64)
    )


def on_cube_surface(nodes):
    return np.flatnonzero(((nodes < 1e-9) | (nodes > 1 - 1e-9)).any(axis=1))


def box(size_mm, *, centre_mm=(0.0, 0.0, 0.0), cells=1):
    """A box's surface, each side cut into cells x cells squares of two triangles."""
    axis = np.arange(cells + 1) / cells - 0.5
    u, v = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    square = np.stack([corner, corner + cells + 1, corner + cells + 2, corner + 1], axis=1)
    triangles = np.vstack([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    vertices, faces = [], []
    for axis_out in range(3):
        for side in (1, -1):
            wall = np.full((len(u), 3), 0.5 * side)
            wall[:, (axis_out + 1) % 3], wall[:, (axis_out + 2) % 3] = u, v
            faces.append(triangles[:, ::side] + sum(len(w) for w in vertices))
            vertices.append(wall)
    return _welded(np.vstack(vertices) * np.asarray(size_mm) + np.asarray(centre_mm), np.vstack(faces))


def tetrahedron(edge_mm, *, centre_mm=(0.0, 0.0, 0.0)):
    """A regular tetrahedron's surface."""
    corner = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * edge_mm / np.sqrt(8)
    return corner + np.asarray(centre_mm), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def star(width_mm, *, centre_mm=(0.0, 0.0, 0.0)):
    """Kepler's eight-pointed star (two tetrahedra through each other): tips at a cube's corners."""
    tips = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]], indexing="ij"), axis=-1).reshape(-1, 3)
    vertices = np.vstack([tips, np.eye(3), -np.eye(3)]) * width_mm / 2
    faces = []
    for k, tip in enumerate(tips):
        root = 8 + np.arange(3) + 3 * (tip < 0)
        turn = 1 if tip.prod() > 0 else -1
        faces += [[k, *root[[i, (i + 1) % 3]][::turn]] for i in range(3)]
    return vertices + np.asarray(centre_mm), np.array(faces)


def smallest_dihedral_deg(nodes_mm, tets):
    """The smallest angle between two faces of each straight tetrahedron, degrees (regular: 70.5)."""
    corner = nodes_mm[tets[:, TET_FACES[:, :3]]]
    normal = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    i, j = np.triu_indices(4, 1)
    cosine = np.einsum("mfx,mfx->mf", normal[:, i], normal[:, j])
    return np.asarray(np.degrees(np.pi - np.arccos(np.clip(cosine, -1, 1))).min(axis=1))


def _welded(vertices, faces):
    _, first, number = np.unique(np.round(vertices, 9), axis=0, return_index=True, return_inverse=True)
    return vertices[first], number.reshape(-1)[faces]

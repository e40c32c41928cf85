"""Shapes that tests mesh: ellipsoids, and an uneven cube of T10 made without the mesher."""

import numpy as np
from scipy.spatial import ConvexHull

from fem.tets import signed_volumes_mm3, with_mid_edges


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


def on_cube_surface(nodes):
    return np.flatnonzero(((nodes < 1e-9) | (nodes > 1 - 1e-9)).any(axis=1))

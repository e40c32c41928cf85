"""Closed triangle surfaces of the specimens of paper.py: boxes, balls, polyhedra."""

import numpy as np
from calculix_mesh import Core, polyhedron

Surface = tuple[np.ndarray, np.ndarray]


def box(low_mm: np.ndarray, high_mm: np.ndarray, *, cell_mm: float = 2.5) -> Surface:
    """A box, its faces cut in squares of about cell_mm, those in two."""
    middle, half = (np.asarray(low_mm) + high_mm) / 2, (np.asarray(high_mm) - low_mm) / 2
    corners, triangles = polyhedron(Core(shape="cube", size_mm=2.0))
    vertices, faces = split(corners, triangles, times=int(np.ceil(np.log2(2 * half.max() / cell_mm))))
    return middle + half * vertices, faces


def core_surface(core: Core) -> Surface:
    """A ball of 5120 triangles, or a polyhedron with each face cut in 64."""
    if core.shape != "ball":
        return split(*polyhedron(core), times=3)
    t = (1 + np.sqrt(5)) / 2
    twelve = np.array([(0, s, u * t) for s in (-1, 1) for u in (-1, 1)])
    corners = np.vstack([np.roll(twelve, k, axis=1) for k in range(3)])
    apart = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    near = np.abs(apart - 2) < 1e-9
    faces = np.array(
        [
            (i, j, k) if np.linalg.det(corners[[i, j, k]]) > 0 else (i, k, j)
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    vertices, faces = split(corners, faces, times=4)
    unit = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    return np.array(core.centre_mm) + core.size_mm * unit, faces


def split(vertices: np.ndarray, faces: np.ndarray, *, times: int) -> Surface:
    """Every triangle in four, so many times over."""
    for _ in range(times):
        ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        pairs, number = np.unique(ends, axis=0, return_inverse=True)
        middle = len(vertices) + number.reshape(-1, 3)
        vertices = np.vstack([vertices, vertices[pairs].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.vstack([np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return vertices, faces.astype(np.int64)

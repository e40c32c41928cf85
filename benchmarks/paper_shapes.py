"""Closed triangle surfaces of the specimens of paper.py: boxes, balls, polyhedra."""

from dataclasses import dataclass

import numpy as np

Surface = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Core:
    """A rigid core; `size_mm` is a ball's radius or a cube's edge; polyhedra have the volume of that cube."""

    shape: str
    size_mm: float
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


def polyhedron(core: Core) -> tuple[np.ndarray, np.ndarray]:
    """Corners and outward triangles of a cube, a tetrahedron or a star of the core cube's volume.

    Tetrahedron: two opposite edges level, along x (above) and y (below). Star: Kepler's stella octangula,
    two tetrahedra through each other, its eight points towards the corners of a cube.
    """
    volume = core.size_mm**3
    cube = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    if core.shape == "cube":
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = [(a, b, c) for a, b, c, d in quads] + [(a, c, d) for a, b, c, d in quads]
        corners, scale = cube, (volume / 8) ** (1 / 3)
    elif core.shape == "tetrahedron":
        r = np.sqrt(2)
        corners = np.array([(r, 0, 1), (-r, 0, 1), (0, r, -1), (0, -r, -1)])
        faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
        scale = (volume / (8 / 3)) ** (1 / 3)
    elif core.shape == "star":
        tips = cube
        hubs = np.array([(s * (k == 0), s * (k == 1), s * (k == 2)) for k in range(3) for s in (-1, 1)])
        corners = np.vstack([tips, hubs])
        faces = []
        for t, tip in enumerate(tips):
            near = [8 + 2 * k + int(tip[k] > 0) for k in range(3)]
            faces += [(t, near[i], near[(i + 1) % 3]) for i in range(3)]
        scale = (volume / 4) ** (1 / 3)
    else:
        raise ValueError(f"found the core shape {core.shape}, expected cube, tetrahedron or star")
    corners = scale * corners
    turned = [
        face
        if np.dot(np.cross(*(corners[list(face[1:])] - corners[face[0]])), corners[list(face)].sum(0)) > 0
        else face[::-1]
        for face in faces
    ]
    return corners + np.array(core.centre_mm), np.array(turned)


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

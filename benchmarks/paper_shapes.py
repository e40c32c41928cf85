"""Closed triangle surfaces of the specimens of paper.py: boxes, balls, polyhedra."""

from dataclasses import dataclass

import numpy as np
import trimesh

Surface = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Core:
    """A rigid core; `size_mm` is a ball's radius or a cube's edge; polyhedra have the volume of that cube."""

    shape: str
    size_mm: float
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


def box(low_mm: np.ndarray, high_mm: np.ndarray, *, cell_mm: float = 2.5) -> Surface:
    """A box, its faces cut in squares of about cell_mm, those in two."""
    middle, half = (np.asarray(low_mm) + high_mm) / 2, (np.asarray(high_mm) - low_mm) / 2
    cube = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    vertices, faces = _split(cube, times=int(np.ceil(np.log2(2 * half.max() / cell_mm))))
    return middle + half * vertices, faces


def core_surface(core: Core) -> Surface:
    """A ball of 5120 triangles, or a polyhedron with each face cut in 64."""
    if core.shape == "ball":
        surface = trimesh.creation.icosphere(subdivisions=4, radius=core.size_mm)
        return np.array(core.centre_mm) + surface.vertices, np.array(surface.faces)
    surface = _polyhedron(core.shape)
    surface.apply_scale(core.size_mm / np.cbrt(surface.volume))
    vertices, faces = _split(surface, times=3)
    return np.array(core.centre_mm) + vertices, faces


def _polyhedron(shape: str) -> trimesh.Trimesh:
    """A cube, a tetrahedron or a star, of any size.

    Tetrahedron: two opposite edges level, along x (above) and y (below). Star: Kepler's stella octangula,
    an octahedron with a corner of the cube over each of its faces.
    """
    if shape == "cube":
        return trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    if shape == "tetrahedron":
        r = np.sqrt(2)
        return trimesh.convex.convex_hull(np.array([(r, 0, 1), (-r, 0, 1), (0, r, -1), (0, -r, -1)]))
    if shape == "star":
        octahedron = trimesh.convex.convex_hull(np.concatenate([np.eye(3), -np.eye(3)]))
        hubs, faces = octahedron.vertices, octahedron.faces
        tips = len(hubs) + np.arange(len(faces))
        sides = [np.column_stack([faces[:, k], faces[:, (k + 1) % 3], tips]) for k in range(3)]
        corners = np.vstack([hubs, hubs[faces].sum(axis=1)])
        return trimesh.Trimesh(corners, np.vstack(sides), process=False)
    raise ValueError(f"found the core shape {shape}, expected ball, cube, tetrahedron or star")


def _split(surface: trimesh.Trimesh, *, times: int) -> Surface:
    """Every triangle in four, so many times over."""
    for _ in range(times):
        surface = surface.subdivide()
    return np.array(surface.vertices), np.array(surface.faces)

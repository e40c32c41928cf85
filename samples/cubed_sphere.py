"""The sphere as six warped square grids: directions without poles, the same for skins and for flesh."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class CubedSphere:
    """Unit directions on a grid over the sides of a cube, without duplicates, and the sides' index grids.

    `faces` holds one index grid per cube side; its two axes and the outward direction are right-handed.
    Neighbouring sides share the indices of their common edge.
    """

    directions: Float[np.ndarray, "n 3"]
    faces: tuple[Int[np.ndarray, "_ _"], ...]

    def triangles(self) -> Int[np.ndarray, "m 3"]:
        """Two triangles per grid cell, outward."""
        corners = [g[window] for g in self.faces for window in _cells()]
        a, b, c, d = (np.concatenate([w.ravel() for w in corners[k::4]]) for k in range(4))
        return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])

    def biquadratic_cells(self) -> Int[np.ndarray, "k 3 3"]:
        """Nine-node cells; every second line of the grid is a line of middle nodes."""
        cells = []
        for grid in self.faces:
            windows = np.lib.stride_tricks.sliding_window_view(grid, (3, 3))[::2, ::2]
            cells.append(windows.reshape(-1, 3, 3))
        return np.concatenate(cells)


def _cells() -> list[tuple[slice, slice]]:
    low, high = slice(None, -1), slice(1, None)
    return [(low, low), (high, low), (high, high), (low, high)]


def cubed_sphere(
    x_angles: Float[np.ndarray, " a"], y_angles: Float[np.ndarray, " b"], z_angles: Float[np.ndarray, " c"]
) -> CubedSphere:
    """Grid on the cube [-1, 1]^3 at tan(angle) along each axis, projected to the unit sphere.

    Each list of angles (radians) runs from -pi/4 to pi/4. Equal angles give cells of nearly equal size. A
    list that is finer at zero narrows the middle cells of the four cube sides along its axis.
    """
    lines = [np.tan(np.asarray(a, dtype=float)) for a in (x_angles, y_angles, z_angles)]
    for line in lines:
        line[0], line[-1] = -1.0, 1.0
    points: list[np.ndarray] = []
    shapes: list[tuple[int, int]] = []
    for axis in range(3):
        u, v = lines[(axis + 1) % 3], lines[(axis + 2) % 3]
        for side in (1.0, -1.0):
            grid = np.empty((len(u), len(v), 3))
            grid[..., axis] = side
            grid[..., (axis + 1) % 3] = u[:, None]
            grid[..., (axis + 2) % 3] = v[None, :]
            if side < 0:
                grid = grid.transpose(1, 0, 2)
            shapes.append((grid.shape[0], grid.shape[1]))
            points.append(grid.reshape(-1, 3))
    everything = np.concatenate(points)
    _, first, index = np.unique(np.round(everything, 9), axis=0, return_index=True, return_inverse=True)
    cube = everything[first]
    ends = np.cumsum([a * b for a, b in shapes])[:-1]
    grids = tuple(part.reshape(s) for part, s in zip(np.split(index.ravel(), ends), shapes, strict=True))
    return CubedSphere(cube / np.linalg.norm(cube, axis=1, keepdims=True), grids)


@lru_cache(maxsize=8)
def even_sphere(cells: int) -> CubedSphere:
    """A cubed sphere of `cells` by `cells` near-equal cells per side, cached, with read-only arrays."""
    angles = np.linspace(-np.pi / 4, np.pi / 4, cells + 1)
    sphere = cubed_sphere(angles, angles, angles)
    for kept in (sphere.directions, *sphere.faces):
        kept.setflags(write=False)
    return sphere

"""Flesh as warped bricks: 27-node hexahedra between the pit and the skin, finer under two pads."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from samples.cubed_sphere import cubed_sphere
from samples.fruit import SampleFruit


@dataclass(frozen=True, kw_only=True)
class Fineness:
    """Cell edges in degrees from the grasp axis, number of cells along it, cell edges in relative depth."""

    degrees: tuple[float, ...]
    along: int
    depths: tuple[float, ...]


SHIPPED = Fineness(degrees=(0, 4.2, 8.4, 12.6, 17.5, 28, 45), along=4, depths=(0, 0.15, 0.34, 0.62, 1))
"""Of the shipped batch: cells 2 mm wide under the pads of a fruit of 30 mm radius, in four layers."""
FINER = Fineness(degrees=(0, 3, 6, 9, 12.2, 16, 22, 32, 45), along=6, depths=(0, 0.1, 0.22, 0.38, 0.62, 1))
"""For the discretisation error of SHIPPED: about 1.4 times as fine in every direction."""
COARSE = Fineness(degrees=(0, 6.5, 14, 45), along=2, depths=(0, 0.3, 1))
"""For tests that need a solution and not an accurate one."""


@dataclass(frozen=True, kw_only=True)
class Bricks:
    """Nodes, 27-node cells (radial index slowest, outward), the skin's nine-node cells, the pit's nodes.

    `relative_depth` of each node: 0 at the skin, 1 at the pit. `follows`: matrix that interpolates the
    displacements of hanging nodes in larger bricks (None: no node hangs).
    """

    nodes_mm: Float[np.ndarray, "n 3"]
    cells: Int[np.ndarray, "m 27"]
    skin_cells: Int[np.ndarray, "k 3 3"]
    pit_nodes: Int[np.ndarray, " p"]
    relative_depth: Float[np.ndarray, " n"]
    follows: csr_array | None = None

    @property
    def free_nodes(self) -> Int[np.ndarray, " f"]:
        """Nodes with unknowns: neither pit nodes nor hanging nodes."""
        free = np.ones(len(self.nodes_mm), dtype=bool)
        free[self.pit_nodes] = False
        if self.follows is not None:
            free &= self.follows.diagonal() == 1.0
        return np.flatnonzero(free)


def flesh_bricks(fruit: SampleFruit, axis: Float[np.ndarray, " 3"], fineness: Fineness) -> Bricks:
    """The true flesh of a fruit, meshed finer where a grasp along `axis` (a unit vector) touches it.

    A node at direction d and relative depth s lies at (1 - s) skin(d) + s pit(d). Nodes lie exactly on the
    skin and the pit; between nodes the error decreases with the third power of the cell's size.
    """
    fine = with_midpoints(np.radians(fineness.degrees))
    graded = np.concatenate([-fine[:0:-1], fine])
    even = np.linspace(-np.pi / 4, np.pi / 4, 2 * fineness.along + 1)
    sphere = cubed_sphere(even, graded, graded)
    directions = sphere.directions @ frame_of(axis)
    skin, pit = fruit.skin.points_mm(directions), fruit.pit.points_mm(directions)
    stations = with_midpoints(np.asarray(fineness.depths))[::-1]
    nodes = np.concatenate([(1 - s) * skin + s * pit for s in stations])
    skin_cells = sphere.biquadratic_cells()
    per_shell = len(directions)
    cells = []
    for layer in range(len(fineness.depths) - 1):
        shells = [skin_cells.reshape(-1, 9) + (2 * layer + k) * per_shell for k in range(3)]
        cells.append(np.concatenate(shells, axis=1))
    return Bricks(
        nodes_mm=nodes,
        cells=np.concatenate(cells),
        skin_cells=skin_cells + (len(stations) - 1) * per_shell,
        pit_nodes=np.arange(per_shell),
        relative_depth=np.repeat(stations, per_shell),
    )


def with_midpoints(borders: Float[np.ndarray, " a"]) -> Float[np.ndarray, " b"]:
    """Cell edges and the midpoints between them: n edges give 2 n - 1 places."""
    full = np.empty(2 * len(borders) - 1)
    full[::2] = borders
    full[1::2] = (borders[1:] + borders[:-1]) / 2
    return full


def frame_of(axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: the axis (not along z) and two unit vectors across it."""
    across = np.cross([0.0, 0.0, 1.0], axis)
    across /= np.linalg.norm(across)
    return np.stack([axis, across, np.cross(axis, across)])


def lagrange(at: Float[np.ndarray, " q"]) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, "q 3"]]:
    """Quadratic Lagrange functions of the nodes -1, 0, 1 and their derivatives."""
    x = np.asarray(at, dtype=float)
    value = np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2], axis=1)
    slope = np.stack([x - 0.5, -2 * x, x + 0.5], axis=1)
    return value, slope

"""27-node bricks, locally refined towards the skin under two pads, level by level.

Each cube face of the flesh starts as `cells` x `cells` bricks, `layers` deep. A brick is cut into eight if it
exceeds the allowed size at its distance from the touched skin. Adjacent bricks differ by at most one level. A
node of a smaller brick that hangs on the face or edge of a larger one is no unknown. It follows the larger
brick's interpolation in place and displacement, so that both are continuous (Rheinboldt and Mesztenyi, ACM
Trans. Math. Softw. 6, 1980).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from samples.cubed_sphere import even_sphere
from samples.fruit import SampleFruit
from samples.hexahedra import Bricks, frame_of, lagrange


@dataclass(frozen=True, kw_only=True)
class BrickGrading:
    """Refinement: bricks along a cube side and in depth before any cut, levels of cuts, growth.

    Bricks at the touched skin have the size of the last level; elsewhere they may be larger by `growth` times
    their distance from it.
    """

    cells: int
    layers: int
    levels: int = 3
    growth: float = 0.7


@dataclass(frozen=True)
class _Boxes:
    """Bricks on the lattice: cube face, lowest corner (two along the face, depth) and size, lattice units."""

    face: Int[np.ndarray, " m"]
    low: Int[np.ndarray, "m 3"]
    size: Int[np.ndarray, " m"]

    def where(self, chosen: np.ndarray) -> "_Boxes":
        return _Boxes(self.face[chosen], self.low[chosen], self.size[chosen])

    def cut(self, chosen: Bool[np.ndarray, " m"]) -> "_Boxes":
        """The chosen ones in eight pieces, the others as they are."""
        rest, whole = self.where(~chosen), self.where(chosen)
        half = whole.size // 2
        corner = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
        pieces = whole.low[:, None] + corner * half[:, None, None]
        return _Boxes(
            np.concatenate([rest.face, np.repeat(whole.face, 8)]),
            np.concatenate([rest.low, pieces.reshape(-1, 3)]),
            np.concatenate([rest.size, np.repeat(half, 8)]),
        )


@dataclass(frozen=True)
class _Lattice:
    """Integer places of all possible nodes, and their positions in the fruit."""

    fruit: SampleFruit
    frame: Float[np.ndarray, "3 3"]
    side: int
    depth: int

    def keys(self, face: Int[np.ndarray, " m"], at: Int[np.ndarray, "m p 3"]) -> Int[np.ndarray, "m p"]:
        """One number per place; places on the common edge of two cube faces have the same number."""
        axis, low = face[:, None] // 2, face[:, None] % 2 == 1
        u, v = np.where(low, at[..., 1], at[..., 0]), np.where(low, at[..., 0], at[..., 1])
        cube = np.empty((*at.shape[:2], 3), dtype=np.int64)
        for a in range(3):
            here = axis == a
            cube[..., a] = np.where(here, np.where(low, 0, self.side), cube[..., a])
            cube[..., (a + 1) % 3] = np.where(here, u, cube[..., (a + 1) % 3])
            cube[..., (a + 2) % 3] = np.where(here, v, cube[..., (a + 2) % 3])
        n = self.side + 1
        return np.asarray(
            ((cube[..., 0] * n + cube[..., 1]) * n + cube[..., 2]) * (self.depth + 1) + at[..., 2]
        )

    def places_mm(
        self, keys: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """Their positions (fruit frame), and their relative depths (0: skin, 1: pit)."""
        rest, down = np.divmod(keys, self.depth + 1)
        n = self.side + 1
        cube = np.tan(
            (np.stack([rest // n**2, rest // n % n, rest % n], axis=1) / self.side - 0.5) * np.pi / 2
        )
        directions = cube / np.linalg.norm(cube, axis=1, keepdims=True) @ self.frame
        s = down / self.depth
        skin, pit = self.fruit.skin.points_mm(directions), self.fruit.pit.points_mm(directions)
        return (1 - s)[:, None] * skin + s[:, None] * pit, s


def graded_bricks(
    fruit: SampleFruit,
    axis: Float[np.ndarray, " 3"],
    grading: BrickGrading,
    *,
    touched_mm: Float[np.ndarray, "t 3"],
) -> Bricks:
    """The true flesh of a fruit in bricks that grow with their distance from the points `touched_mm`."""
    unit = 2 ** (grading.levels + 1)
    lattice = _Lattice(
        fruit=fruit, frame=frame_of(axis), side=grading.cells * unit, depth=grading.layers * unit
    )
    boxes = _refined(lattice, _coarsest(grading, unit), grading, touched_mm)
    cell_keys = lattice.keys(boxes.face, _in_brick(boxes, _LOCAL))
    keys, cells = np.unique(cell_keys, return_inverse=True)
    cells = cells.reshape(-1, 27)
    nodes, depth = lattice.places_mm(keys)
    follows = _follows(lattice, boxes, keys, cells)
    return Bricks(
        nodes_mm=nodes if follows is None else np.asarray(follows @ nodes),
        cells=cells,
        skin_cells=cells[boxes.low[:, 2] == 0, 18:].reshape(-1, 3, 3),
        pit_nodes=np.flatnonzero(keys % (lattice.depth + 1) == lattice.depth),
        relative_depth=depth,
        follows=follows,
    )


def touched_skin_mm(
    fruit: SampleFruit,
    turn: Float[np.ndarray, "3 3"],
    *,
    touch_mm: Float[np.ndarray, " 3"],
    overlap_mm: float,
) -> Float[np.ndarray, "t 3"]:
    """Points of the skin within `overlap_mm` of a pad's face (axes `turn`) at first touch."""
    points = fruit.skin.points_mm(even_sphere(96).directions)
    return np.asarray(points[(points - touch_mm) @ turn[:, 2] < overlap_mm])


_LOCAL = np.stack(np.meshgrid([2, 1, 0], [0, 1, 2], [0, 1, 2], indexing="ij"), axis=-1).reshape(27, 3)[
    :, [1, 2, 0]
]
"""Nodes of a brick in half sizes: two along the face, and depth (slowest, outward), as in
samples.hexahedra."""


def _in_brick(boxes: _Boxes, halves: Int[np.ndarray, "p 3"]) -> Int[np.ndarray, "m p 3"]:
    return np.asarray(boxes.low[:, None] + halves * (boxes.size // 2)[:, None, None])


def _coarsest(grading: BrickGrading, unit: int) -> _Boxes:
    n, k = grading.cells, grading.layers
    at = np.stack(np.meshgrid(range(6), range(n), range(n), range(k), indexing="ij"), axis=-1).reshape(-1, 4)
    return _Boxes(at[:, 0], at[:, 1:] * unit, np.full(len(at), unit))


def _refined(
    lattice: _Lattice, boxes: _Boxes, grading: BrickGrading, touched_mm: Float[np.ndarray, "t 3"]
) -> _Boxes:
    """Cut bricks by size and distance, then until adjacent bricks differ by at most one level."""
    tree = cKDTree(touched_mm)
    mean_mm = float(np.linalg.norm(touched_mm - np.asarray(lattice.fruit.skin.centre_mm), axis=1).mean())
    unit_mm = np.pi / 2 * mean_mm / lattice.side
    smallest_mm = 2 * unit_mm
    for level in range(grading.levels):
        here = boxes.size == 2 ** (grading.levels + 1 - level)
        corner = lattice.keys(boxes.face[here], _in_brick(boxes.where(here), _LOCAL))
        keys, back = np.unique(corner, return_inverse=True)
        away = np.asarray(tree.query(lattice.places_mm(keys)[0])[0])
        away = away[back].reshape(-1, 27).min(axis=1)
        # cells at the edge of the touched skin must not have hanging nodes: bricks at the skin count as one
        # cell nearer
        away = np.where(boxes.low[here, 2] == 0, np.maximum(away - smallest_mm, 0.0), away)
        asked_mm = smallest_mm + grading.growth * away
        chosen = np.zeros(len(here), dtype=bool)
        chosen[here] = boxes.size[here] * unit_mm > 1.01 * asked_mm
        boxes = boxes.cut(chosen)
    return _balanced(lattice, boxes)


def _balanced(lattice: _Lattice, boxes: _Boxes) -> _Boxes:
    """Cut bricks adjacent to one of less than half their size, largest difference first, until none is."""
    sizes = sorted(set(boxes.size.tolist()))
    for small in sizes:
        corners = np.unique(lattice.keys(boxes.face, _in_brick(boxes, 2 * _cube(2)))[boxes.size == small])
        for large in [s for s in sizes[::-1] if s >= 4 * small]:
            here = boxes.size == large
            steps = _cube(large // small + 1)
            surface = steps[np.any((steps == 0) | (steps == large // small), axis=1)]
            at = boxes.low[here][:, None] + small * surface
            chosen = np.zeros(len(here), dtype=bool)
            chosen[here] = np.isin(lattice.keys(boxes.face[here], at), corners).any(axis=1)
            boxes = boxes.cut(chosen)
    return boxes


def _cube(count: int) -> Int[np.ndarray, "c 3"]:
    line = np.arange(count)
    return np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)


def _follows(
    lattice: _Lattice, boxes: _Boxes, keys: Int[np.ndarray, " n"], cells: Int[np.ndarray, "m 27"]
) -> csr_array | None:
    """Matrix that gives every node from free ones: itself, or the interpolation of the larger brick.

    None without hanging nodes. If a node hangs on hanging nodes, its row goes back to free ones.
    """
    quarters = _cube(5)
    on_surface = np.any((quarters == 0) | (quarters == 4), axis=1)
    between = quarters[on_surface & np.any(quarters % 2 == 1, axis=1)]
    at = boxes.low[:, None] + between * (boxes.size // 4)[:, None, None]
    candidate = lattice.keys(boxes.face, at)
    # the smallest bricks have no lattice places between their nodes, and nothing hangs on them
    place = np.minimum(np.searchsorted(keys, candidate), len(keys) - 1)
    hangs = (keys[place] == candidate) & (boxes.size >= 4)[:, None]
    brick, which = np.nonzero(hangs)
    if len(brick) == 0:
        return None
    node = place[brick, which]
    _, first = np.unique(node, return_index=True)
    brick, which, node = brick[first], which[first], node[first]
    shares = _brick_weights(between / 2.0 - 1.0)[which]
    row, column = np.nonzero(np.abs(shares) > 1e-12)
    count = len(keys)
    free = np.ones(count, dtype=bool)
    free[node] = False
    kept = np.flatnonzero(free)
    step = csr_array(
        coo_array(
            (
                np.concatenate([np.ones(len(kept)), shares[row, column]]),
                (np.concatenate([kept, node[row]]), np.concatenate([kept, cells[brick[row], column]])),
            ),
            shape=(count, count),
        )
    )
    follows = step
    while np.any(~free[follows.indices]):
        follows = csr_array(follows @ step)
    return follows


def _brick_weights(at: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 27"]:
    """Shape functions of a brick at places (two along the face, depth, each -1 to 1)."""
    (a, _), (b, _), (c, _) = (lagrange(at[:, k]) for k in range(3))
    return np.asarray(np.einsum("qr,qu,qv->qruv", c[:, ::-1], a, b).reshape(-1, 27))

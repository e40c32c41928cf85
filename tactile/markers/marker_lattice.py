"""The markers at rest as a lattice: which are neighbours, and which steps take it onto itself."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, QhullError, cKDTree

NEIGHBOURS = 8
"""Of a marker: those round it on a square grid."""
LONG_EDGE = 1.7
"""Neighbours are those joined by an edge no longer than this many spacings."""
VOTE_BINS = 0.25
"""Of displacements that are voted for, in spacings: finer than neighbours differ. Set by hand."""
VOTE_REACH = 2.5
"""Spacings that a gel moves between two frames at most. Set by hand."""
VOTED_GUESSES = 4
"""Best voted displacements that are tried in full. Set by hand."""
STEPS = 8
"""Steps of a grid to its neighbours, diagonals included; a hexagonal one has six."""
FEWEST_ON_GRID = 6
"""Markers that a step must leave within the outline to be judged by: scattered ones meet by chance. Set by
hand."""
ON_GRID = 0.3
"""In spacings: a marker that a step brings so near to another one's place lies on it. Set by hand."""


@dataclass(frozen=True)
class Lattice:
    """The markers at rest (px), their usual spacing, which are neighbours, and each one's nearest few.

    `steps_px`: steps that take most of the markers to another one's place; none where they are scattered.
    `shape`: of the picture; `margin_px`: a marker is whole, and is seen, so far inside its edge.
    """

    rest_px: Float[np.ndarray, "n 2"]
    spacing_px: float
    edges: Int[np.ndarray, "e 2"]
    nearest: Int[np.ndarray, "n k"]
    steps_px: Float[np.ndarray, "s 2"]
    shape: tuple[int, int]
    margin_px: float


def lattice_of(
    rest_px: Float[np.ndarray, "n 2"], spacing_px: float, *, shape: tuple[int, int], margin_px: float
) -> Lattice:
    """Neighbours are Delaunay's, without the long edges of the hull."""
    count = len(rest_px)
    nearest = np.asarray(cKDTree(rest_px).query(rest_px, k=min(NEIGHBOURS + 1, count))[1]).reshape(count, -1)
    try:
        triangles = Delaunay(rest_px).simplices if count > 3 else np.zeros((0, 3), dtype=np.int64)
    except QhullError:  # all on a line
        triangles = np.zeros((0, 3), dtype=np.int64)
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    length = np.linalg.norm(rest_px[pairs[:, 0]] - rest_px[pairs[:, 1]], axis=1)
    edges = pairs[length < LONG_EDGE * spacing_px]
    steps = _steps(rest_px, spacing_px)
    return Lattice(rest_px, spacing_px, edges, nearest[:, 1:], steps, shape, margin_px)


def _steps(rest_px: Float[np.ndarray, "n 2"], spacing_px: float) -> Float[np.ndarray, "s 2"]:
    """Steps up to a square's diagonal by which most markers, put there, lie on another one."""
    tree = cKDTree(rest_px)
    pairs = tree.query_pairs(LONG_EDGE * spacing_px, output_type="ndarray")
    offsets = rest_px[pairs[:, 1]] - rest_px[pairs[:, 0]]
    kinds = voted(np.concatenate([offsets, -offsets]), spacing_px, most=STEPS)
    steps = [step for step in kinds if _regular(tree, rest_px, step, spacing_px)]
    return np.array([*steps, *(-step for step in steps)]).reshape(-1, 2)


def _regular(
    tree: cKDTree, rest_px: Float[np.ndarray, "n 2"], step: Float[np.ndarray, "2"], spacing_px: float
) -> bool:
    """Whether most of the markers that a step leaves within their outline come to lie on another one."""
    low, high = rest_px.min(axis=0), rest_px.max(axis=0)
    there = rest_px + step
    within = ((there > low) & (there < high)).all(axis=1)
    away = np.asarray(tree.query(there[within])[0])
    return bool(len(away) >= FEWEST_ON_GRID and (away < ON_GRID * spacing_px).mean() > 0.5)


def neighbours_say(
    lattice: Lattice,
    displacement_px: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
    *,
    of: Bool[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n 2"]:
    """Each marker's displacement as its known neighbours have it: an affine fit, a mean where they are few.

    Weights fall with distance; a marker's own value is not used. Without any known marker near, the mean of
    all. `of`: the markers that are asked for, zero for the others; None: all.
    """
    asked = np.arange(len(known)) if of is None else np.flatnonzero(of)
    said = np.zeros((len(known), 2))
    if not len(asked):
        return said
    near = lattice.nearest[asked]
    offset = (lattice.rest_px[near] - lattice.rest_px[asked][:, None]) / lattice.spacing_px
    weight = known[near] / (0.5 + (offset**2).sum(axis=2))
    values = np.where(known[near][..., None], displacement_px[near], 0.0)
    total = weight.sum(axis=1)
    everyone = displacement_px[known].mean(axis=0) if known.any() else np.zeros(2)
    mean = np.einsum("nk,nkc->nc", weight, values) / np.maximum(total, 1e-9)[:, None]
    basis = np.concatenate([np.ones((*offset.shape[:2], 1)), offset], axis=2)
    # A little stiffness on the slopes keeps one-sided neighbourhoods (the rim) from running away.
    normal = np.einsum("nk,nki,nkj->nij", weight, basis, basis) + np.diag([1e-6, 0.2, 0.2])
    right = np.einsum("nk,nki,nkc->nic", weight, basis, values - mean[:, None])
    fitted = mean + np.linalg.solve(normal, right)[:, 0]
    said[asked] = np.where((total > 0)[:, None], fitted, everyone)
    return said


def whole_displacement(lattice: Lattice, position_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Each marker's displacement (px); of one without a position (NaN) what its neighbours say."""
    known = np.isfinite(position_px[:, 0])
    moved = np.where(known[:, None], position_px - lattice.rest_px, 0.0)
    return np.where(known[:, None], moved, neighbours_say(lattice, moved, known, of=~known))


def voted(
    jumps_px: Float[np.ndarray, "j 2"], spacing_px: float, *, most: int = VOTED_GUESSES
) -> list[Float[np.ndarray, "2"]]:
    """The commonest of many jumps, most votes first."""
    jumps = jumps_px / spacing_px
    jumps = jumps[np.abs(jumps).max(axis=1) < VOTE_REACH]
    cells = np.rint(jumps / VOTE_BINS).astype(np.int64)
    kinds, count = np.unique(cells, axis=0, return_counts=True)
    chosen: list[np.ndarray] = []
    for kind in kinds[np.argsort(-count, kind="stable")[: 4 * most]]:
        near = np.abs(jumps / VOTE_BINS - kind).max(axis=1) <= 1.0
        middle = jumps[near].mean(axis=0) * spacing_px
        if all(np.linalg.norm(middle - other) > 0.4 * spacing_px for other in chosen):
            chosen.append(middle)
    return chosen[:most]

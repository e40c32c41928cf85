"""The markers at rest as a lattice: neighbours, and translations that map it onto itself."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, QhullError, cKDTree

NEIGHBOURS = 8
"""Neighbours of a marker: those around it on a square grid."""
LONG_EDGE = 1.7
"""Longest edge between neighbours, in spacings."""
VOTE_BINS = 0.25
"""Bin width for votes on displacements, in spacings: less than neighbours differ. Set by hand."""
VOTE_REACH = 2.5
"""Largest motion of a gel between two frames, in spacings. Set by hand."""
VOTED_GUESSES = 4
"""Displacements with the most votes that are tried in full. Set by hand."""
STEPS = 8
"""Steps of a grid to its neighbours, with diagonals; a hexagonal grid has six."""
FEWEST_ON_GRID = 6
"""Fewest markers within the outline after a step for a test of it: a few coincide by chance. Set by hand."""
ON_GRID = 0.3
"""Distance, in spacings, within which a shifted marker coincides with another one. Set by hand."""


@dataclass(frozen=True)
class Lattice:
    """The markers at rest (px), their usual spacing, pairs of neighbours, and each one's nearest few.

    `steps_px`: translations that map most markers onto others; none if they are scattered. `shape`: height
    and width of the picture; `margin_px`: distance from its edge at which a marker is wholly visible.
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
    """The lattice; Delaunay edges join neighbours, except for long ones at the hull."""
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
    """Translations, up to a square's diagonal, that map most markers onto others."""
    tree = cKDTree(rest_px)
    pairs = tree.query_pairs(LONG_EDGE * spacing_px, output_type="ndarray")
    offsets = rest_px[pairs[:, 1]] - rest_px[pairs[:, 0]]
    kinds = voted(np.concatenate([offsets, -offsets]), spacing_px, most=STEPS)
    steps = [step for step in kinds if _regular(tree, rest_px, step, spacing_px)]
    return np.array([*steps, *(-step for step in steps)]).reshape(-1, 2)


def _regular(
    tree: cKDTree, rest_px: Float[np.ndarray, "n 2"], step: Float[np.ndarray, "2"], spacing_px: float
) -> bool:
    """Whether most of the markers that stay within the outline after a step coincide with another one."""
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
    """Each marker's displacement (px) by its known neighbours: an affine fit, shrunk towards their mean.

    Weights fall with distance; a marker's own value has none. Markers without known neighbours get the mean
    of all. `of`: markers to compute, zero for the others; None: all.
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
    # Regularised slopes keep one-sided neighbourhoods (at the rim) from extrapolating.
    normal = np.einsum("nk,nki,nkj->nij", weight, basis, basis) + np.diag([1e-6, 0.2, 0.2])
    right = np.einsum("nk,nki,nkc->nic", weight, basis, values - mean[:, None])
    fitted = mean + np.linalg.solve(normal, right)[:, 0]
    said[asked] = np.where((total > 0)[:, None], fitted, everyone)
    return said


def whole_displacement(lattice: Lattice, position_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Each marker's displacement (px); for one without a position (NaN) the estimate by its neighbours."""
    known = np.isfinite(position_px[:, 0])
    moved = np.where(known[:, None], position_px - lattice.rest_px, 0.0)
    return np.where(known[:, None], moved, neighbours_say(lattice, moved, known, of=~known))


def voted(
    jumps_px: Float[np.ndarray, "j 2"], spacing_px: float, *, most: int = VOTED_GUESSES
) -> list[Float[np.ndarray, "2"]]:
    """The most frequent displacements (px) among many, most votes first."""
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

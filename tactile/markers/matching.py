"""Which blob of a frame is which marker.

A marker's displacement is near its neighbours': a gel has no seams. Each guess of the displacements is
matched to the blobs and the match is scored by how far neighbours disagree and how many markers find no blob;
the best guess wins. Where markers stand on a grid, a jump of the whole gel by more than half a pitch between
two frames looks like a smaller jump the other way: only the grid's rim, a guess from the motion so far, or
the rest position can tell, and all three are tried.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError, cKDTree

GATE = 0.5
"""A blob farther from where a marker is expected than this share of the spacing is not taken for it."""
NEIGHBOURS = 8
"""Of a marker: those round it on a square grid."""
LONG_EDGE = 1.7
"""Neighbours are those joined by an edge no longer than this many spacings."""
UNMATCHED_COST = 1.0
"""Of all markers unmatched, in the unit of the misfit between neighbours (spacings). Set by hand."""
VOTE_BINS = 0.25
"""Of displacements that are voted for, in spacings: finer than neighbours differ. Set by hand."""
VOTE_REACH = 2.5
"""Spacings that a gel moves between two frames at most. Set by hand."""
VOTED_GUESSES = 4
"""Best voted displacements that are tried in full. Set by hand."""
SEAM = 0.4
"""Neighbours whose displacements differ by more than this share of the spacing are on two sides of a seam."""
SEEDS = 3
"""Patches of markers that move alike, from which the rest is matched in turn. Set by hand."""
FEWEST_SEEDS = 4
"""Markers of such a patch, at least. Set by hand."""
GROWTH_ROUNDS = 12
"""Of matching what is next to the patch: a gel of some 25 markers across is reached. Set by hand."""
GROWTH_NEIGHBOURS = 6
"""Nearest of a marker, two of which must be matched for it to be next. Set by hand."""


@dataclass(frozen=True)
class Lattice:
    """The markers at rest (px), their usual spacing, which are neighbours, and each one's nearest few."""

    rest_px: Float[np.ndarray, "n 2"]
    spacing_px: float
    edges: Int[np.ndarray, "e 2"]
    nearest: Int[np.ndarray, "n k"]


@dataclass(frozen=True)
class Match:
    """`blob[n]` is marker n's blob or -1; `cost` is lower for a smoother and fuller match."""

    blob: Int[np.ndarray, " n"]
    cost: float

    @property
    def found(self) -> Bool[np.ndarray, " n"]:
        """Whether each marker has a blob."""
        return np.asarray(self.blob >= 0)


def lattice_of(rest_px: Float[np.ndarray, "n 2"], spacing_px: float) -> Lattice:
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
    return Lattice(rest_px, spacing_px, pairs[length < LONG_EDGE * spacing_px], nearest[:, 1:])


def match(
    lattice: Lattice,
    guesses: list[Float[np.ndarray, "n 2"]],
    blobs_px: Float[np.ndarray, "m 2"],
    expected: Bool[np.ndarray, " n"],
) -> Match:
    """The best match over the guessed displacements; a jump of the whole gel too where blobs are left.

    `expected`: the markers that should be in view; the others cost nothing when they are not found.
    """
    if not len(blobs_px):
        return Match(np.full(len(lattice.rest_px), -1), np.inf)
    tree = cKDTree(blobs_px)
    tried = [_matched(lattice, guess, blobs_px, tree, expected) for guess in guesses]
    best = min(tried, key=lambda one: one.cost)
    missing = int((expected & ~best.found).sum())
    spare = len(blobs_px) - int(best.found.sum())
    if missing >= 2 and spare >= 2:
        jumps = _voted_jumps(lattice.rest_px + guesses[0], blobs_px, lattice.spacing_px)
        tried = [best, *(_matched(lattice, guesses[0] + jump, blobs_px, tree, expected) for jump in jumps)]
        best = min(tried, key=lambda one: one.cost)
    torn = _seams(lattice, best, blobs_px)
    if torn.any():
        again = [best, *_regrown(lattice, best, torn, blobs_px, tree, expected)]
        best = min(again, key=lambda one: one.cost)
    return best


def neighbours_say(
    lattice: Lattice, displacement_px: Float[np.ndarray, "n 2"], known: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    """Each marker's displacement as its known neighbours have it: an affine fit, a mean where they are few.

    Weights fall with distance; a marker's own value is not used. Without any known marker near, the mean of
    all.
    """
    near = lattice.nearest
    offset = (lattice.rest_px[near] - lattice.rest_px[:, None]) / lattice.spacing_px
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
    return np.where((total > 0)[:, None], fitted, everyone)


def _matched(
    lattice: Lattice,
    guess: Float[np.ndarray, "n 2"],
    blobs_px: Float[np.ndarray, "m 2"],
    tree: cKDTree,
    expected: Bool[np.ndarray, " n"],
) -> Match:
    """Nearest both ways, then once more from where the neighbours' matches put each marker."""
    blob = _mutual(lattice.rest_px + guess, blobs_px, tree, GATE * lattice.spacing_px)
    known = blob >= 0
    error = np.where(known[:, None], blobs_px[blob] - lattice.rest_px - guess, 0.0)
    drift = _median_of_known(error[lattice.nearest], known[lattice.nearest])
    blob = _mutual(lattice.rest_px + guess + drift, blobs_px, tree, GATE * lattice.spacing_px)
    return Match(blob, _cost(lattice, blob, blobs_px, expected))


def _median_of_known(
    values: Float[np.ndarray, "n k 2"], known: Bool[np.ndarray, "n k"]
) -> Float[np.ndarray, "n 2"]:
    """Median over the known ones of each row; zero where there are none."""
    ordered = np.sort(np.where(known[..., None], values, np.inf), axis=1)
    count = known.sum(axis=1)
    rows = np.arange(len(values))
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    middle = (ordered[rows, low] + ordered[rows, high]) / 2
    return np.where((count > 0)[:, None], middle, 0.0)


def _seams(lattice: Lattice, best: Match, blobs_px: Float[np.ndarray, "m 2"]) -> Bool[np.ndarray, " e"]:
    """The pairs of neighbours that a match tears apart, or pushes onto each other."""
    displacement = blobs_px[best.blob] - lattice.rest_px
    a, b = lattice.edges.T
    apart = np.linalg.norm(displacement[a] - displacement[b], axis=1) > SEAM * lattice.spacing_px
    return np.asarray(apart & best.found[a] & best.found[b])


def _regrown(
    lattice: Lattice,
    best: Match,
    torn: Bool[np.ndarray, " e"],
    blobs_px: Float[np.ndarray, "m 2"],
    tree: cKDTree,
    expected: Bool[np.ndarray, " n"],
) -> Iterator[Match]:
    """Matches that keep one unbroken part of `best` and let the rest grow from it, marker by marker.

    A region that took its neighbours' blobs is inwardly smooth; only the seam around it shows.
    """
    count = len(lattice.rest_px)
    a, b = lattice.edges[~torn & best.found[lattice.edges].all(axis=1)].T
    links = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
    part = connected_components(links, directed=False)[1]
    sizes = np.bincount(part[best.found], minlength=1)
    for seed in np.argsort(-sizes, kind="stable")[:SEEDS]:
        if sizes[seed] < FEWEST_SEEDS:
            return
        blob = np.where((part == seed) & best.found, best.blob, -1)
        for _ in range(GROWTH_ROUNDS):
            known = blob >= 0
            ready = ~known & (known[lattice.nearest[:, :GROWTH_NEIGHBOURS]].sum(axis=1) >= 2)
            displacement = np.where(known[:, None], blobs_px[blob] - lattice.rest_px, 0.0)
            where = lattice.rest_px + neighbours_say(lattice, displacement, known)
            found = _mutual(where, blobs_px, tree, GATE * lattice.spacing_px)
            grown = ready & (found >= 0) & ~np.isin(found, blob[known])
            if not grown.any():
                break
            blob = np.where(grown, found, blob)
        yield Match(blob, _cost(lattice, blob, blobs_px, expected))


def _cost(
    lattice: Lattice,
    blob: Int[np.ndarray, " n"],
    blobs_px: Float[np.ndarray, "m 2"],
    expected: Bool[np.ndarray, " n"],
) -> float:
    """Mean square disagreement of neighbours in spacings (at most 1 each) and the share without a blob."""
    known = blob >= 0
    if not known.any():
        return float("inf")
    displacement = blobs_px[blob] - lattice.rest_px
    a, b = lattice.edges.T
    both = known[a] & known[b]
    apart = ((displacement[a[both]] - displacement[b[both]]) ** 2).sum(axis=1) / lattice.spacing_px**2
    rough = float(np.minimum(apart, 1.0).mean()) if both.any() else 1.0
    return rough + UNMATCHED_COST * float((expected & ~known).sum() / max(1, expected.sum()))


def _mutual(
    where_px: Float[np.ndarray, "n 2"], blobs_px: Float[np.ndarray, "m 2"], tree: cKDTree, gate_px: float
) -> Int[np.ndarray, " n"]:
    """Pairs that are each other's nearest within the gate; -1 for the rest."""
    away, blob = tree.query(where_px)
    marker = cKDTree(where_px).query(blobs_px)[1]
    fits = (np.asarray(away) <= gate_px) & (np.asarray(marker)[blob] == np.arange(len(where_px)))
    return np.where(fits, blob, -1)


def _voted_jumps(
    where_px: Float[np.ndarray, "n 2"], blobs_px: Float[np.ndarray, "m 2"], spacing_px: float
) -> list[Float[np.ndarray, "2"]]:
    """Jumps of the whole gel that would put most markers on a blob, most votes first."""
    jumps = (blobs_px[None] - where_px[:, None]).reshape(-1, 2) / spacing_px
    jumps = jumps[np.abs(jumps).max(axis=1) < VOTE_REACH]
    cells = np.rint(jumps / VOTE_BINS).astype(np.int64)
    kinds, count = np.unique(cells, axis=0, return_counts=True)
    chosen: list[np.ndarray] = []
    for kind in kinds[np.argsort(-count, kind="stable")[: 4 * VOTED_GUESSES]]:
        near = np.abs(jumps / VOTE_BINS - kind).max(axis=1) <= 1.0
        middle = jumps[near].mean(axis=0) * spacing_px
        if all(np.linalg.norm(middle - other) > 0.4 * spacing_px for other in chosen):
            chosen.append(middle)
    return chosen[:VOTED_GUESSES]

"""Local refinement: longest-edge bisection of tetrahedra until edges near the pads are as short as asked."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from fem.elements.shape_functions import TET_EDGES
from fem.mesh.tetrahedra import pair_keys, unique_edges

#: edges up to this many times the wanted length stay: halving then leaves them around it
LONGEST = 1.5
#: passes of bisection after which refinement stops at the latest
PASSES = 12

SizeField = Callable[[Float[np.ndarray, "p 3"]], Float[np.ndarray, " p"]]


def size_near(
    at_mm: Float[np.ndarray, "q 3"],
    *,
    radius_mm: float | Float[np.ndarray, " q"],
    edge_mm: float | Float[np.ndarray, " q"],
    growth: float = 0.5,
) -> SizeField:
    """The wanted edge length: edge_mm within radius_mm of the points, plus growth x distance beyond.

    Both may be given point by point: the nearest one's count.
    """
    tree = cKDTree(at_mm)
    edges, radii = (np.broadcast_to(value, len(at_mm)) for value in (edge_mm, radius_mm))

    def size_mm(points_mm: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
        distance, nearest = tree.query(points_mm)
        return np.asarray(edges[nearest] + growth * np.maximum(distance - radii[nearest], 0.0))

    return size_mm


def affordable_size(
    nodes_mm: Float[np.ndarray, "n 3"],
    tets: Int[np.ndarray, "m 4"],
    at_mm: Float[np.ndarray, "q 3"],
    *,
    radius_mm: float | Float[np.ndarray, " q"],
    edge_mm: float | Float[np.ndarray, " q"],
    dof_limit: int,
) -> SizeField:
    """`size_near` for the shortest edges, from edge_mm up, for which the T10 mesh keeps within dof_limit.

    Tried out by bisection alone, about a tenth coarser each time. The limit gives way where the mesh without
    refinement already exceeds it.
    """
    before = t10_dofs(tets)
    while True:
        size = size_near(at_mm, radius_mm=radius_mm, edge_mm=edge_mm)
        nodes, finer = bisected(nodes_mm, tets, size)
        dofs = t10_dofs(finer)
        if dofs <= dof_limit or len(nodes) == len(nodes_mm):
            return size
        room = max(dof_limit - before, 0.02 * before)
        edge_mm = edge_mm * max(1.08, ((dofs - before) / room) ** 0.3)


def t10_dofs(tets: Int[np.ndarray, "m 4"]) -> int:
    """Degrees of freedom of the T10 mesh on these tetrahedra: three at every corner and edge."""
    return 3 * (len(np.unique(tets)) + len(unique_edges(tets, TET_EDGES)[0]))


def bisected(
    nodes_mm: Float[np.ndarray, "n 3"],
    tets: Int[np.ndarray, "m 4"],
    size_mm: SizeField,
    *,
    settle: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> tuple[Float[np.ndarray, "n2 3"], Int[np.ndarray, "m2 4"]]:
    """`bisect_once` until nothing is too long, at most PASSES times.

    `settle`: new places of all nodes after a pass, from nodes, tetrahedra and the numbers of the new nodes.
    """
    for _ in range(PASSES):
        before = len(nodes_mm)
        nodes_mm, tets = bisect_once(nodes_mm, tets, size_mm)
        if len(nodes_mm) == before:
            break
        if settle is not None:
            nodes_mm = settle(nodes_mm, tets, np.arange(before, len(nodes_mm)))
    return nodes_mm, tets


def bisect_once(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"], size_mm: SizeField
) -> tuple[Float[np.ndarray, "n2 3"], Int[np.ndarray, "m2 4"]]:
    """Bisect the longest edge of every tetrahedron in which it is longer than wanted; the mesh conforms.

    Marks are closed first: a tetrahedron with any marked edge has its longest one marked too (Rivara, 1984).
    Each tetrahedron is then cut at its longest marked edge until none is left; ranks are global, so two
    neighbours cut their common face alike. The new nodes come last, at edge middles.
    """
    edges, of_tet = unique_edges(tets, TET_EDGES)
    length = np.linalg.norm(nodes_mm[edges[:, 1]] - nodes_mm[edges[:, 0]], axis=1)
    too_long = length > LONGEST * size_mm(nodes_mm[edges].mean(axis=1))
    rank = np.argsort(np.argsort(length, kind="stable"))
    marked = _closed_marks(rank, of_tet, too_long)
    if not marked.any():
        return nodes_mm, tets
    nodes = np.vstack([nodes_mm, nodes_mm[edges[marked]].mean(axis=1)])
    cut_keys, cut_rank = pair_keys(edges[marked]), rank[marked]  # ascending, as edges are
    done = []
    while len(tets):
        key = pair_keys(np.sort(tets[:, TET_EDGES], axis=2))
        at = np.minimum(np.searchsorted(cut_keys, key), len(cut_keys) - 1)
        rank_of_edge = np.where(cut_keys[at] == key, cut_rank[at], -1)
        longest = (np.arange(len(tets)), rank_of_edge.argmax(axis=1))
        cut = rank_of_edge[longest] >= 0
        done.append(tets[~cut])
        node, which = len(nodes_mm) + at[longest][cut], longest[1][cut]
        first, second, rows = tets[cut], tets[cut], np.arange(len(which))
        first[rows, TET_EDGES[which, 1]] = node
        second[rows, TET_EDGES[which, 0]] = node
        tets = np.vstack([first, second])
    return nodes, np.vstack(done)


def _closed_marks(
    rank: Int[np.ndarray, " e"], of_tet: Int[np.ndarray, "m 6"], too_long: Bool[np.ndarray, " e"]
) -> Bool[np.ndarray, " e"]:
    """Marks such that the longest edge of every touched tetrahedron is among them."""
    longest = of_tet[np.arange(len(of_tet)), rank[of_tet].argmax(axis=1)]
    marked = np.zeros(len(rank), dtype=bool)
    marked[longest[too_long[of_tet].any(axis=1)]] = True
    while True:
        wanted = longest[marked[of_tet].any(axis=1)]
        if marked[wanted].all():
            return marked
        marked[wanted] = True

"""Where every number goes in a multifrontal elimination: all that follows from the pattern alone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array

from fem.sparse.elimination_order import elimination_tree, same_pattern_groups
from fem.sparse.extend_add import RelativeIndices
from fem.sparse.supernodes import Supernodes, supernodes

#: levels of the tree whose boundaries shape the order within a front
_LEVELS = 8


@dataclass(frozen=True)
class Entries:
    """Number `source` of the matrix goes to the place `target` of its front.

    Those of front s are bounds[s] to bounds[s + 1]. Places are counted through the square of the front's
    pivots and then the rows below, both column by column.
    """

    source: Int[np.ndarray, " e"]
    target: Int[np.ndarray, " e"]
    bounds: list[int]


NO_ENTRIES = Entries(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), [])
"""Those of a factorised matrix, which needs none."""


@dataclass(frozen=True)
class Fronts:
    """Dense fronts in the order of elimination; children come before parents, subtrees are runs of fronts.

    order: dofs in the order of elimination.
    start, rows: front s eliminates start[s] to start[s + 1] of them and changes `rows[s]` (positions in the
    order, ascending).
    entries: where the numbers of the matrix go.
    first_below[s]: the first pivot of the subtree that ends with front s.
    """

    order: Int[np.ndarray, " d"]
    start: list[int]
    rows: list[Int[np.ndarray, " _"]]
    parent: list[int]
    relative_indices: list[RelativeIndices | None]
    entries: Entries
    first_below: list[int]

    @cached_property
    def position(self) -> Int[np.ndarray, " d"]:
        """Of each dof in the order of elimination."""
        return np.argsort(self.order)


def fronts(matrix: csr_array) -> Fronts:
    """Fill-reducing order, supernodes, and all index maps, for a symmetric pattern stored in full."""
    groups = same_pattern_groups(matrix)
    tree = elimination_tree(groups)
    nodes = supernodes(tree, groups.size)
    pivots = _in_long_runs(nodes, len(tree.order))
    ordered = np.concatenate(pivots)
    position = np.argsort(ordered)
    group = tree.order[ordered]
    size = groups.size[group]
    offset = np.concatenate([[0], np.cumsum(size)])
    order = groups.members[ranges(groups.start[group], size)]
    last_group = np.cumsum([len(p) for p in pivots])
    start = np.concatenate([[0], offset[last_group]])
    counts = np.array([len(r) for r in nodes.rows])
    split = np.cumsum(counts)
    at = np.concatenate(nodes.rows)
    front = np.repeat(np.arange(len(counts)), counts)
    key = np.sort(front * len(ordered) + position[at])
    at = key - front * len(ordered)
    weight = np.concatenate([[0], np.cumsum(size[at])])
    rows = np.split(ranges(offset[at], size[at]), weight[split[:-1]])
    starts, parent = start.tolist(), nodes.parent
    first = list(range(len(parent)))
    for s, p in enumerate(parent):
        if p >= 0:
            first[p] = min(first[p], first[s])
    return Fronts(
        order=order,
        start=starts,
        rows=rows,
        parent=parent,
        relative_indices=[_relative_indices(s, starts, rows, parent) for s in range(len(parent))],
        entries=front_entries(matrix, order=order, start=starts, rows=rows),
        first_below=[starts[f] for f in first],
    )


def ranges(start: Int[np.ndarray, " k"], length: Int[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
    """start[0], start[0] + 1, ... (length[0] of them), start[1], ..."""
    end = np.cumsum(length)
    return np.asarray(np.arange(end[-1] if len(end) else 0) + np.repeat(start - (end - length), length))


def front_entries(
    matrix: csr_array,
    *,
    order: Int[np.ndarray, " d"],
    start: list[int],
    rows: list[Int[np.ndarray, " _"]],
) -> Entries:
    """Of a symmetric pattern; `order`, `start` and `rows` are those of the Fronts.

    The row of a dof is read as its column.
    """
    position = np.argsort(order)
    length = np.diff(matrix.indptr)[order]
    where = np.empty(len(order), dtype=np.int64)
    sources, targets, bounds = [], [], [0]
    for s, changed in enumerate(rows):
        first, last = start[s], start[s + 1]
        p, q = last - first, len(changed)
        where[first:last] = np.arange(p)
        where[changed] = np.arange(p * p, p * p + q)
        source = ranges(matrix.indptr[order[first:last]], length[first:last])
        column = np.repeat(np.arange(p), length[first:last])
        at = position[matrix.indices[source]]
        keep = at >= first
        local, column = where[at[keep]], column[keep]
        sources.append(source[keep])
        targets.append(local + np.where(local < p, p, q) * column)
        bounds.append(bounds[-1] + len(local))
    return Entries(np.concatenate(sources), np.concatenate(targets), bounds)


def _in_long_runs(nodes: Supernodes, n: int) -> list[Int[np.ndarray, " _"]]:
    """Pivots of each supernode, reordered so that what a descendant's front touches of them lies together.

    Any order within a dense front is as good as another, so this costs nothing, and updates are added in long
    stretches. Pivots are sorted by the branches that lead to the first and to the last front that touch them.
    """
    count = len(nodes.parent)
    depth, branches = [0] * count, [0] * count
    for s in range(count - 1, -1, -1):
        p = nodes.parent[s]
        if p >= 0:
            depth[s] = depth[p] + 1
    path = np.zeros((count, max(depth) + _LEVELS + 2), dtype=np.int8)
    for s in range(count - 1, -1, -1):
        p = nodes.parent[s]
        if p >= 0:
            path[s] = path[p]
            path[s, depth[p]] = min(branches[p], 127)
            branches[p] += 1
    touching = np.repeat(np.arange(count), [len(r) for r in nodes.rows])
    touched = np.concatenate(nodes.rows)
    owner = np.empty(n, dtype=np.int64)
    pivots = np.concatenate(nodes.pivots)
    owner[pivots] = np.repeat(np.arange(count), [len(p) for p in nodes.pivots])
    first, last = owner.copy(), owner.copy()
    first[touched[::-1]] = touching[::-1]
    last[touched] = touching
    level = np.array(depth)[owner]
    keys = [owner]
    for k in range(_LEVELS):
        keys += [path[first, level + k], path[last, level + k]]
    ordered = np.lexsort(keys[::-1])
    return np.split(ordered, np.cumsum([len(p) for p in nodes.pivots])[:-1])


def _relative_indices(
    s: int, start: list[int], rows: list[np.ndarray], parent: list[int]
) -> RelativeIndices | None:
    p = parent[s]
    if p < 0:
        return None
    n_pivots = start[p + 1] - start[p]
    below = int(np.searchsorted(rows[s], start[p + 1]))
    among_rows = n_pivots + np.searchsorted(rows[p], rows[s][below:])
    return RelativeIndices.at(np.concatenate([rows[s][:below] - start[p], among_rows]), n_pivots=n_pivots)

"""Where every number goes in a multifrontal elimination: all that follows from the pattern alone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array

from fem.sparse.elimination_order import EliminationTree, elimination_tree, same_pattern_groups
from fem.sparse.extend_add import RelativeIndices

#: subtrees with at most so many dofs are one front
LEAF_DOFS = 48
#: a front is cut where rows enter it beyond this share of its size, and beyond so many dofs
GROWTH_SHARE, GROWTH_DOFS = 0.2, 48


@dataclass(frozen=True)
class Supernodes:
    """pivots[s] and rows[s] are positions in the tree's order, ascending; children come before parents.

    parent[s] is -1 for roots. Each subtree is a run of consecutive supernodes.
    """

    pivots: list[Int[np.ndarray, " _"]]
    rows: list[Int[np.ndarray, " _"]]
    parent: list[int]


def supernodes(tree: EliminationTree, size: Int[np.ndarray, " g"]) -> Supernodes:
    """Merge small subtrees and chains of the elimination tree at the price of few explicit zeros."""
    weight = size[tree.order]
    below = weight.tolist()
    for v, p in enumerate(tree.parent):
        if p >= 0:
            below[p] += below[v]
    small = np.array(below) <= LEAF_DOFS
    pivots, rows, hanging = _leaves(tree, small)
    column_start = np.searchsorted(tree.low, np.arange(len(weight) + 1))
    for chain in _chains(tree, small):
        parts, counts = [], []
        for v in chain:
            new = [tree.high[column_start[v] : column_start[v + 1]], *(rows[s] for s in hanging[v])]
            parts += new
            counts.append(sum(map(len, new)))
        touched, first = np.unique(np.concatenate(parts), return_index=True)
        step = np.repeat(np.arange(len(chain)), counts)[first]
        groups = np.array(chain)
        entered = np.cumsum(np.bincount(step, weights=weight[touched], minlength=len(chain)))
        for a, b in _cuts(entered.tolist(), np.cumsum(weight[groups]).tolist()):
            pivots.append(groups[a:b])
            rows.append(touched[(step < b) & (touched > groups[b - 1])])
        if tree.parent[chain[-1]] >= 0:
            hanging[tree.parent[chain[-1]]].append(len(pivots) - 1)
    return _postordered(pivots, rows, len(weight))


def _leaves(
    tree: EliminationTree, small: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray], list[list[int]]]:
    """The small subtrees: pivots, rows, and for each group the leaves that hang directly below it."""
    n = len(small)
    leaf = np.full(n, -1)
    hanging: list[list[int]] = [[] for _ in range(n)]
    count, number = 0, leaf.tolist()
    for v in np.flatnonzero(small)[::-1].tolist():
        p = tree.parent[v]
        if p >= 0 and number[p] >= 0:
            number[v] = number[p]
            continue
        number[v] = count
        if p >= 0:
            hanging[p].append(count)
        count += 1
    leaf = np.array(number)
    out = (leaf[tree.low] >= 0) & (leaf[tree.high] != leaf[tree.low])
    key = np.unique(leaf[tree.low[out]].astype(np.int64) * n + tree.high[out])
    rows = np.split(key % n, np.searchsorted(key, np.arange(1, count) * n)) if count else []
    inside = np.flatnonzero(leaf >= 0)
    inside = inside[np.argsort(leaf[inside], kind="stable")]
    pivots = np.split(inside, np.searchsorted(leaf[inside], np.arange(1, count))) if count else []
    return list(pivots), list(rows), hanging


def _chains(tree: EliminationTree, small: np.ndarray) -> list[list[int]]:
    """Paths of groups above the small subtrees along which the tree does not branch, bottom first."""
    n = len(small)
    branches, below = [0] * n, [-1] * n
    chain: list[list[int]] = [[] for _ in range(n)]
    chains = []
    for v in np.flatnonzero(~small).tolist():
        if branches[v] == 1:
            chain[v] = chain[below[v]]
        else:
            chains.append(chain[v])
        chain[v].append(v)
        p = tree.parent[v]
        if p >= 0:
            branches[p] += 1
            below[p] = v
    return sorted(chains, key=lambda path: path[-1])


def _cuts(entered: list[float], eliminated: list[int]) -> list[tuple[int, int]]:
    """Where to cut a chain: entered and eliminated dofs are counted up to each of its groups."""
    cuts, done = [0], 0
    for k in range(1, len(entered)):
        front = entered[k] - done
        if entered[k] - entered[cuts[-1]] > max(GROWTH_DOFS, GROWTH_SHARE * front):
            cuts.append(k)
            done = eliminated[k - 1]
    return list(zip(cuts, [*cuts[1:], len(entered)], strict=True))


def _postordered(pivots: list[np.ndarray], rows: list[np.ndarray], n: int) -> Supernodes:
    """The supernodes in postorder of their tree: children before parents, subtrees together."""
    owner = np.empty(n, dtype=np.int64)
    owner[np.concatenate(pivots)] = np.repeat(np.arange(len(pivots)), [len(p) for p in pivots])
    parent = [int(owner[r[0]]) if len(r) else -1 for r in rows]
    children: list[list[int]] = [[] for _ in pivots]
    stack: list[int] = []
    for s, p in enumerate(parent):
        (children[p] if p >= 0 else stack).append(s)
    order = []
    while stack:
        s = stack.pop()
        order.append(s)
        stack += children[s]
    order.reverse()
    rank = np.argsort(order)
    return Supernodes(
        [pivots[s] for s in order],
        [rows[s] for s in order],
        [int(rank[parent[s]]) if parent[s] >= 0 else -1 for s in order],
    )


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

"""Groups that are eliminated together in one dense front, and the rows that each elimination changes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from fem.sparse.elimination_order import EliminationTree

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

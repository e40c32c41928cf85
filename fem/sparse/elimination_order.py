"""The order in which unknowns are eliminated, and what hangs on what: from the pattern of nonzeros alone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.sparse.linalg import spilu

try:
    import pymetis
except ImportError:  # there is no wheel for Linux on ARM
    pymetis = None

#: rows hashed together: few enough to stay near the processor
_BATCH = 2048


@dataclass(frozen=True)
class Groups:
    """Dofs whose rows have one and the same pattern (those of a node): they are ordered as one.

    `start` and `members` list the dofs of each group. `entry_start` and `entry_dof` list the columns of its
    rows, in the order in which they are stored.
    """

    of_dof: Int[np.ndarray, " d"]
    members: Int[np.ndarray, " d"]
    start: Int[np.ndarray, " g1"]
    entry_start: Int[np.ndarray, " g1"]
    entry_dof: Int[np.ndarray, " e"]

    @property
    def size(self) -> Int[np.ndarray, " g"]:
        """Dofs in each group."""
        return np.diff(self.start)

    @cached_property
    def links(self) -> tuple[Int[np.ndarray, " l"], Int[np.ndarray, " l"]]:
        """Pairs of different groups that share a nonzero, both ways, sorted by the first."""
        is_first = np.zeros(len(self.of_dof), dtype=bool)
        is_first[self.members[self.start[:-1]]] = True
        row = np.repeat(np.arange(len(self.size)), np.diff(self.entry_start))
        column = self.of_dof[self.entry_dof]
        keep = is_first[self.entry_dof] & (row != column)
        return row[keep], column[keep]


@dataclass(frozen=True)
class EliminationTree:
    """Groups in elimination order, and the tree that says which elimination waits for which.

    parent[v] is the first group that is changed by the elimination of v, -1 for none. The links are those of
    the matrix between positions of the order, low < high, sorted by low.
    """

    order: Int[np.ndarray, " g"]
    parent: list[int]
    low: Int[np.ndarray, " l"]
    high: Int[np.ndarray, " l"]


def same_pattern_groups(matrix: csr_array) -> Groups:
    """Rows with equal columns, found by a hash: the sum of a random number for each column."""
    weight = np.random.default_rng(1).integers(1, 2**62, size=matrix.shape[0], dtype=np.int64)
    mark = np.empty_like(weight)
    for a in range(0, len(mark), _BATCH):
        part = matrix.indptr[a : a + _BATCH + 1]
        mark[a : a + _BATCH] = np.add.reduceat(  # wraps around
            weight[matrix.indices[part[0] : part[-1]]], part[:-1] - part[0]
        )
    _, first, of_dof = np.unique(mark, return_index=True, return_inverse=True)
    of_dof = np.argsort(np.argsort(first))[of_dof]  # keeps the numbering's locality
    start = np.concatenate([[0], np.cumsum(np.bincount(of_dof))])
    members = np.argsort(of_dof, kind="stable")
    length = np.diff(matrix.indptr)[members[start[:-1]]].astype(np.int64)
    entry_start = np.concatenate([[0], np.cumsum(length)])
    shift = matrix.indptr[members[start[:-1]]] - entry_start[:-1]
    entry = np.arange(entry_start[-1]) + np.repeat(shift, length)
    return Groups(of_dof, members, start, entry_start, matrix.indices[entry])


def ordering() -> str:
    """The fill-reducing order in use: METIS, or minimum degree where pymetis is not installed."""
    return "minimum degree" if pymetis is None else "METIS"


def elimination_tree(groups: Groups) -> EliminationTree:
    """A fill-reducing order and its elimination tree: nested dissection by METIS, else minimum degree."""
    row, column = groups.links
    n = len(groups.size)
    if not len(row):
        return tree_in_order(groups, np.arange(n))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n))]).astype(np.int32)
    if pymetis is None:
        return tree_in_order(groups, _minimum_degree(indptr, column.astype(np.int32)))
    order, _ = pymetis.nested_dissection(
        pymetis.CSRAdjacency(indptr, column.astype(np.int32)), vweights=groups.size.astype(np.int32)
    )
    # METIS has another integer of 64 bits
    return tree_in_order(groups, np.asarray(order).astype(np.int64))


def _minimum_degree(indptr: Int[np.ndarray, " g1"], column: Int[np.ndarray, " l"]) -> Int[np.ndarray, " g"]:
    """SuperLU's multiple minimum degree order (Liu 1985) of a symmetric graph.

    SciPy gives it only with a factorisation. This one is incomplete and keeps no fill: it costs little.
    """
    n = len(indptr) - 1
    graph = csc_array((np.ones(len(column)), column, indptr), shape=(n, n))
    factor = spilu(
        graph + n * eye_array(n, format="csc"),
        drop_tol=1.0,
        fill_factor=1.0,
        diag_pivot_thresh=0.0,
        permc_spec="MMD_AT_PLUS_A",
        options={"SymmetricMode": True},
    )
    return np.argsort(factor.perm_c)


def tree_in_order(groups: Groups, order: Int[np.ndarray, " g"]) -> EliminationTree:
    """The elimination tree of groups eliminated in a given order."""
    row, column = groups.links
    n = len(order)
    place = np.argsort(order)
    low, high = place[row], place[column]
    once = low < high
    low, high = low[once], high[once]
    by_low = np.argsort(low * n + high)
    low, high = low[by_low], high[by_low]
    return EliminationTree(order, _parents(low, high, n), low, high)


def _parents(low: Int[np.ndarray, " l"], high: Int[np.ndarray, " l"], n: int) -> list[int]:
    """The elimination tree of a graph is that of its minimum spanning tree for the link weight `high`.

    Both trees follow from which groups hang together once all up to v are there (Liu, "The role of
    elimination trees in sparse factorization", SIAM J. Matrix Anal. Appl. 11, 1990), and a minimum spanning
    tree keeps just that. It has one link per group, so that the loop below is short.
    """
    links = csr_array((high + 1.0, (high, low)), shape=(n, n))
    tree = minimum_spanning_tree(links).tocoo()
    a, b = np.maximum(tree.row, tree.col), np.minimum(tree.row, tree.col)
    ascending = np.argsort(a, kind="stable")
    parent, top = [-1] * n, list(range(n))
    for later, v in zip(a[ascending].tolist(), b[ascending].tolist(), strict=True):
        while top[v] != v:
            top[v] = top[top[v]]
            v = top[v]
        parent[v] = top[v] = later
    return parent

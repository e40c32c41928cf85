"""Where the nodal blocks of T10 elements go in the global matrix: sorted once, used for every material."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import bsr_array, csr_array


@dataclass(frozen=True)
class ElementPattern:
    """Pairs of nodes that share an element, sorted by row and column: the pattern of the stiffness.

    indptr, indices: compressed rows over nodes. mirror: the place of (b, a) for each pair (a, b).
    gather: sums the numbers of all element-local pairs, (m, 10, 10) laid out flat, into those of the pairs.

    For a material whose stiffness changes (Newton's steps), build it once per mesh with `of` and call
    `matrix(elements)` each time: the result always has the same indptr and indices, so that one
    fem.sparse.solver.analyse serves all of them.
    """

    n_nodes: int
    indptr: Int[np.ndarray, " n1"]
    indices: Int[np.ndarray, " s"]
    mirror: Int[np.ndarray, " s"]
    gather: csr_array

    @classmethod
    def of(cls, tets: Int[np.ndarray, "m 10"], n_nodes: int) -> "ElementPattern":
        """Sort the hundred pairs of every element."""
        tets = tets.astype(np.int64)
        pair = (tets[:, :, None] * n_nodes + tets[:, None, :]).reshape(-1)
        local = np.argsort(pair, kind="stable")
        pair = pair[local]
        start = np.flatnonzero(np.concatenate([[True], pair[1:] != pair[:-1]]))
        pair = pair[start]
        shape = (len(start), 100 * len(tets))
        gather = csr_array((np.ones(len(local)), local, np.concatenate([start, [len(local)]])), shape=shape)
        indptr = np.searchsorted(pair, np.arange(n_nodes + 1) * n_nodes)
        indices = pair % n_nodes
        numbered = csr_array((np.arange(len(pair)), indices, indptr), shape=(n_nodes, n_nodes))
        return cls(n_nodes, numbered.indptr, numbered.indices, numbered.tocsc().data, gather)

    def scatter(self, elements: Float[np.ndarray, "m 30 30"]) -> Float[np.ndarray, "s 3 3"]:
        """Sum of the element matrices (dofs node by node, three each) in the blocks of the pairs."""
        blocks = elements.reshape(-1, 10, 3, 10, 3).transpose(0, 1, 3, 2, 4).reshape(-1, 9)
        return np.asarray(self.gather @ blocks).reshape(-1, 3, 3)

    def matrix(self, elements: Float[np.ndarray, "m 30 30"]) -> csr_array:
        """The assembled matrix on three dofs a node."""
        return self.blocks(self.scatter(elements)).tocsr()

    def blocks(self, values: Float[np.ndarray, "s 3 3"]) -> bsr_array:
        """A matrix from the blocks of the pairs."""
        size = 3 * self.n_nodes
        return bsr_array((values, self.indices, self.indptr), shape=(size, size))

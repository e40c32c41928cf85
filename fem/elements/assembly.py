"""Stiffness of the flesh for unit material constants, assembled in batches.

K(mu, lambda) = mu K_mu + lambda K_lambda, with u the displacement and v its variation:

    K_lambda:  integral of  div u  div v
    K_mu:      integral of  grad u : grad v + grad u : grad v'          (= 2 eps(u) : eps(v))

so that another Poisson's ratio costs one sparse sum. Both follow from one array per element,
H[a i, b j] = integral of dN_a/dx_i dN_b/dx_j:  K_lambda is H itself, and
K_mu[a i, b j] = delta_ij sum_k H[a k, b k] + H[a j, b i].
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import bsr_array, csr_array

from fem.elements.gradients import gradient_products, slopes_and_volumes
from fem.elements.shape_functions import t10_gradient, t10_shape, tet_quadrature
from fem.fem_failure import FemFailure, FemProblem

LARGEST_POISSON_RATIO = 0.4999
"""Beyond it the flesh is incompressible to these elements, and its stiffness is all rounding."""


@dataclass(frozen=True)
class Stiffness:
    """The two parts of the stiffness matrix on all nodes, three dofs each (3 n, 3 n), mm."""

    k_mu: bsr_array
    k_lambda: bsr_array

    def for_unit_modulus(self, *, poisson_ratio: float) -> csr_array:
        """K0, the stiffness for E = 1 MPa: mu = 1 / (2 (1 + nu)), lambda = nu / ((1 + nu) (1 - 2 nu))."""
        mu, lame = unit_lame_constants(poisson_ratio)
        data = mu * self.k_mu.data
        data += lame * self.k_lambda.data
        whole = bsr_array((data, self.k_mu.indices, self.k_mu.indptr), shape=self.k_mu.shape).tocsr()
        short = [part.astype(np.int32) for part in (whole.indices, whole.indptr)]  # half the indices' memory
        return csr_array((whole.data, *short), shape=whole.shape)

    def change_with_poisson_ratio(
        self, displacement: Float[np.ndarray, "d f"], *, poisson_ratio: float
    ) -> Float[np.ndarray, "d f"]:
        """(dK0/dnu) u, column by column."""
        shear, lame = lame_constants_slope(poisson_ratio)
        return np.asarray(shear * (self.k_mu @ displacement) + lame * (self.k_lambda @ displacement))


def unit_lame_constants(poisson_ratio: float) -> tuple[float, float]:
    """Shear modulus and Lame's first constant for E = 1 MPa.

    Raises BAD_POISSON_RATIO below zero and above LARGEST_POISSON_RATIO.

    >>> unit_lame_constants(0.25)
    (0.4, 0.4)
    """
    if not 0 <= poisson_ratio <= LARGEST_POISSON_RATIO:
        raise FemFailure(
            FemProblem.BAD_POISSON_RATIO,
            f"Poisson's ratio is {poisson_ratio:g}, expected a value between 0 and "
            f"{LARGEST_POISSON_RATIO:g}; wet flesh has 0.3 to 0.49",
        )
    return 0.5 / (1 + poisson_ratio), poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))


def lame_constants_slope(poisson_ratio: float) -> tuple[float, float]:
    """Derivatives of both to Poisson's ratio."""
    shear = -0.5 / (1 + poisson_ratio) ** 2
    return shear, (1 + 2 * poisson_ratio**2) / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio)) ** 2


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


def assemble(nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]) -> Stiffness:
    """Both parts of the stiffness of T10 elements: straight ones exactly, curved ones with 14 points."""
    pattern = ElementPattern.of(tets, len(nodes_mm))
    lame = np.empty((len(pattern.indices), 3, 3))
    for i, j, h in gradient_products(nodes_mm, tets):
        lame[:, i, j] = pattern.gather @ h.reshape(-1)
        if i != j:
            lame[:, j, i] = lame[pattern.mirror, i, j]
    shear = lame.transpose(0, 2, 1).copy()
    trace = np.trace(lame, axis1=1, axis2=2)
    for i in range(3):
        shear[:, i, i] += trace
    return Stiffness(pattern.blocks(shear), pattern.blocks(lame))


def scattered(elements: Float[np.ndarray, "m e e"], cells: Int[np.ndarray, "m _"], n_nodes: int) -> csr_array:
    """Sum of matrices of a few elements or faces, three dofs a node, on all nodes (3 n, 3 n)."""
    width = elements.shape[1]
    dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(-1, width)
    row, column = np.repeat(dofs, width, axis=1).ravel(), np.tile(dofs, (1, width)).ravel()
    return csr_array((elements.ravel(), (row, column)), shape=(3 * n_nodes, 3 * n_nodes))


def lumped_moments(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]
) -> Float[np.ndarray, "n 4"]:
    """Integrals of N_a and of N_a x over the flesh: nodal loads of a uniform and of a linear body force."""
    points, weights = tet_quadrature()
    shape = t10_shape(points)
    x = nodes_mm[tets]
    volume = slopes_and_volumes(x, t10_gradient(points))[1] * weights
    place = np.concatenate([np.ones((*volume.shape, 1)), shape @ x], axis=2)
    load = (shape.T @ (volume[..., None] * place)).reshape(-1, 4)
    where = tets.ravel()
    return np.stack(
        [np.bincount(where, weights=component, minlength=len(nodes_mm)) for component in load.T], axis=1
    )

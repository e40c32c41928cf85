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

from fem.elements import t10_gradient, t10_shape, tet_quadrature
from fem.failure import FemFailure, FemProblem

LARGEST_POISSON_RATIO = 0.4999
"""Beyond it the flesh is incompressible to these elements, and its stiffness is all rounding."""
_BATCH = 4096


@dataclass(frozen=True)
class Stiffness:
    """The two parts of the stiffness matrix on all nodes, three dofs each (3 n, 3 n), mm."""

    k_mu: bsr_array
    k_lambda: bsr_array

    def for_unit_modulus(self, *, poisson_ratio: float) -> csr_array:
        """K0, the stiffness for E = 1 MPa: mu = 1 / (2 (1 + nu)), lambda = nu / ((1 + nu) (1 - 2 nu))."""
        mu, lame = unit_lame_constants(poisson_ratio)
        data = mu * self.k_mu.data + lame * self.k_lambda.data
        return bsr_array((data, self.k_mu.indices, self.k_mu.indptr), shape=self.k_mu.shape).tocsr()


def unit_lame_constants(poisson_ratio: float) -> tuple[float, float]:
    """Shear modulus and Lame's first constant for E = 1 MPa.

    Raises BAD_POISSON_RATIO below zero and above LARGEST_POISSON_RATIO.
    """
    if not 0 <= poisson_ratio <= LARGEST_POISSON_RATIO:
        raise FemFailure(
            FemProblem.BAD_POISSON_RATIO,
            f"Poisson's ratio is {poisson_ratio:g}, but must lie between 0 and {LARGEST_POISSON_RATIO:g}; "
            "wet flesh has 0.3 to 0.49",
        )
    return 0.5 / (1 + poisson_ratio), poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))


def assemble(nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]) -> Stiffness:
    """Both parts of the stiffness of curved T10 elements (14-point quadrature)."""
    pair, slot = _node_pairs(tets, len(nodes_mm))
    lame = np.zeros((len(pair), 3, 3))
    shear = np.zeros((len(pair), 3, 3))
    for start in range(0, len(tets), _BATCH):
        part = slice(start, start + _BATCH)
        h = _gradient_products(nodes_mm[tets[part]])
        trace = np.einsum("makbk->mab", h)
        volumetric = h.transpose(0, 1, 3, 2, 4)  # (m, a, b, i, j)
        deviatoric = h.transpose(0, 1, 3, 4, 2) + trace[..., None, None] * np.eye(3)
        where = slot[part].ravel()
        for blocks, total in ((volumetric, lame), (deviatoric, shear)):
            flat = blocks.reshape(-1, 9)
            for k in range(9):
                total.reshape(-1, 9)[:, k] += np.bincount(where, weights=flat[:, k], minlength=len(pair))
    indptr = np.searchsorted(pair // len(nodes_mm), np.arange(len(nodes_mm) + 1))
    column = pair % len(nodes_mm)
    shape = (3 * len(nodes_mm), 3 * len(nodes_mm))
    return Stiffness(
        bsr_array((shear, column, indptr), shape=shape), bsr_array((lame, column, indptr), shape=shape)
    )


def lumped_moments(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]
) -> Float[np.ndarray, "n 4"]:
    """Integrals of N_a and of N_a x over the flesh: nodal loads of a uniform and of a linear body force."""
    points, weights = tet_quadrature()
    shape = t10_shape(points)
    x = nodes_mm[tets]
    volume = np.linalg.det(np.einsum("qin,mnx->mqix", t10_gradient(points), x)) * weights
    place = np.concatenate([np.ones((*volume.shape, 1)), np.einsum("qn,mnx->mqx", shape, x)], axis=2)
    load = np.einsum("mq,qn,mqk->mnk", volume, shape, place, optimize=True)
    total = np.zeros((len(nodes_mm), 4))
    np.add.at(total, tets, load)
    return total


def _gradient_products(x: Float[np.ndarray, "m 10 3"]) -> Float[np.ndarray, "m 10 3 10 3"]:
    """H of each element: integral of dN_a/dx_i dN_b/dx_j."""
    points, weights = tet_quadrature()
    reference = t10_gradient(points)  # (q, i, n)
    jacobian = np.einsum("qin,mnx->mqix", reference, x, optimize=True)  # dx_x/dxi_i
    measure = np.linalg.det(jacobian) * weights
    slope = np.linalg.solve(jacobian, reference[None])  # (m, q, x, n)
    scaled = slope * np.sqrt(measure)[..., None, None]
    flat = scaled.transpose(0, 1, 3, 2).reshape(len(x), len(weights), 30)
    return np.asarray(flat.transpose(0, 2, 1) @ flat).reshape(len(x), 10, 3, 10, 3)


def _node_pairs(
    tets: Int[np.ndarray, "m 10"], n_nodes: int
) -> tuple[Int[np.ndarray, " s"], Int[np.ndarray, "m 100"]]:
    """Every pair of nodes that share an element, sorted row by row, and each element's places there."""
    key = (tets[:, :, None].astype(np.int64) * n_nodes + tets[:, None, :]).reshape(-1)
    pair, slot = np.unique(key, return_inverse=True)
    return pair, slot.reshape(len(tets), 100)

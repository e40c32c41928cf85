"""Bricks of flesh around a rigid pit: linear stiffness, and nodal forces as forces on the unknowns.

Unknowns are the free nodes' displacements and the pit's shift and rotation vector. The pit turns as a rigid
body through any angle. samples.mismatch.flesh_laws holds the laws at finite strain.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array, eye_array, kron
from scipy.spatial.transform import Rotation

from samples.hexahedra import Bricks, lagrange

HOLDING_N_PER_MM = 2e-2
"""Weak spring on the pit, which holds a free fruit: a shift of 0.01 mm costs 0.2 mN."""
HOLDING = HOLDING_N_PER_MM * np.array([1.0, 1.0, 1.0, 400.0, 400.0, 400.0])
"""That spring's stiffness against the pit's shift (N/mm) and rotation (N mm/rad)."""


@dataclass(frozen=True, kw_only=True)
class BrickFlesh:
    """One meshed fruit; `slopes` are shape function gradients and `volumes` weights at 27 points per cell."""

    bricks: Bricks
    mu_MPa: float
    lam_MPa: float
    slopes: Float[np.ndarray, "m 27 27 3"]
    volumes: Float[np.ndarray, "m 27"]
    free_nodes: Int[np.ndarray, " f"]
    stiffness: csr_array
    pit_centre_mm: Float[np.ndarray, " 3"]

    @property
    def unknowns(self) -> int:
        """Three per free node, six for the pit."""
        return 3 * len(self.free_nodes) + 6

    def dofs_of(self, nodes: Int[np.ndarray, " k"]) -> Int[np.ndarray, "k 3"]:
        """Unknowns of free nodes. Raises ValueError for nodes of the pit and for hanging nodes."""
        place = np.searchsorted(self.free_nodes, nodes)
        if not np.array_equal(self.free_nodes[np.minimum(place, len(self.free_nodes) - 1)], nodes):
            raise ValueError("a pad may touch skin whose nodes hang on larger bricks: refine a wider zone")
        return 3 * place[:, None] + np.arange(3)

    def displacement(self, q: Float[np.ndarray, " u"]) -> Float[np.ndarray, "n 3"]:
        """Nodal displacement, mm, of the unknowns q."""
        u = np.zeros_like(self.bricks.nodes_mm)
        u[self.free_nodes] = q[:-6].reshape(-1, 3)
        arms = self.bricks.nodes_mm[self.bricks.pit_nodes] - self.pit_centre_mm
        u[self.bricks.pit_nodes] = q[-6:-3] + Rotation.from_rotvec(q[-3:]).apply(arms) - arms
        return u if self.bricks.follows is None else np.asarray(self.bricks.follows @ u)

    def on_unknowns(
        self, nodal_N: Float[np.ndarray, "n 3"], q: Float[np.ndarray, " u"]
    ) -> Float[np.ndarray, " u"]:
        """Internal nodal forces as forces on the unknowns at q, with the pit's springs; moments are about the
        pit's centre.
        """
        if self.bricks.follows is not None:
            nodal_N = np.asarray(self.bricks.follows.T @ nodal_N)
        force = np.empty_like(q)
        force[:-6] = nodal_N[self.free_nodes].ravel()
        pit = nodal_N[self.bricks.pit_nodes]
        arms = self.bricks.nodes_mm[self.bricks.pit_nodes] - self.pit_centre_mm
        force[-6:-3] = pit.sum(axis=0)
        force[-3:] = np.cross(Rotation.from_rotvec(q[-3:]).apply(arms), pit).sum(axis=0)
        force[-6:] += HOLDING * q[-6:]
        return force


def flesh_of(bricks: Bricks, *, E_MPa: float, poisson_ratio: float) -> BrickFlesh:
    """Integrate the bricks (27 Gauss points) and assemble the linear stiffness with a rigid pit.

    Raises ValueError if a brick is inverted.
    """
    mu, lam = lame_constants(E_MPa, poisson_ratio)
    slopes, volumes = shape_gradients(bricks.nodes_mm[bricks.cells])
    if volumes.min() <= 0:
        raise ValueError(f"{int((volumes.min(axis=1) <= 0).sum())} bricks of the sample mesh are inside out")
    count = len(bricks.nodes_mm)
    free = bricks.free_nodes
    centre = bricks.nodes_mm[bricks.pit_nodes].mean(axis=0)
    full = assembled(bricks.cells, slopes, volumes, mu, lam, count)
    tie = rigid_tie(bricks, free, centre)
    stiffness = csr_array(tie.T @ full @ tie)
    ends = np.arange(stiffness.shape[0] - 6, stiffness.shape[0])
    stiffness = csr_array(stiffness + coo_array((HOLDING, (ends, ends)), shape=stiffness.shape).tocsr())
    return BrickFlesh(
        bricks=bricks,
        mu_MPa=mu,
        lam_MPa=lam,
        slopes=slopes,
        volumes=volumes,
        free_nodes=free,
        stiffness=stiffness,
        pit_centre_mm=centre,
    )


def lame_constants(E_MPa: float, nu: float) -> tuple[float, float]:
    """Lame's constants mu and lambda, MPa."""
    return E_MPa / (2 * (1 + nu)), E_MPa * nu / ((1 + nu) * (1 - 2 * nu))


def shape_gradients(
    corners: Float[np.ndarray, "m 27 3"],
) -> tuple[Float[np.ndarray, "m 27 27 3"], Float[np.ndarray, "m 27"]]:
    """Gradients of the shape functions (1/mm; cell, point, node, axis) and volumes (mm³) of each brick's 27
    Gauss points. `corners`: its nodes, mm.
    """
    at, weight = np.polynomial.legendre.leggauss(3)
    value, slope = lagrange(at)
    product = "ai,bj,ck->abcijk"
    local = np.stack(
        [np.einsum(product, value, slope, value), np.einsum(product, value, value, slope),
         np.einsum(product, slope, value, value)],
        axis=-1,
    ).reshape(27, 27, 3)  # fmt: skip
    jacobian = np.einsum("gnk,mni->mgik", local, corners)
    volumes = np.linalg.det(jacobian) * np.einsum("a,b,c->abc", weight, weight, weight).ravel()
    return np.matmul(local[None], np.linalg.inv(jacobian)), volumes


def assembled(
    cells: Int[np.ndarray, "m 27"], slopes: np.ndarray, volumes: np.ndarray, mu: float, lam: float, count: int
) -> csr_array:
    """Stiffness of all nodes' displacements; linear in `volumes`, the integration points' weights."""
    m = len(cells)
    total = csr_array((3 * count, 3 * count))
    for part in np.array_split(np.arange(m), max(1, m // 600)):
        flat = slopes[part].transpose(0, 2, 3, 1).reshape(len(part), 81, 27)
        product = np.matmul(flat * volumes[part][:, None, :], flat.transpose(0, 2, 1))
        pairs = product.reshape(-1, 27, 3, 27, 3)
        block = lam * pairs + mu * pairs.transpose(0, 1, 4, 3, 2)
        trace = np.einsum("eakbk->eab", pairs)
        for i in range(3):
            block[:, :, i, :, i] += mu * trace
        dofs = (3 * cells[part][:, :, None] + np.arange(3)).reshape(len(part), 81)
        total = total + scattered(block, dofs, 3 * count)
    return total


def scattered(blocks: np.ndarray, dofs: Int[np.ndarray, "m k"], size: int) -> csr_array:
    """The sum of the cells' square blocks, each at the unknowns of its cell."""
    count = dofs.shape[1]
    rows, columns = np.repeat(dofs, count, axis=1).ravel(), np.tile(dofs, (1, count)).ravel()
    return csr_array(coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)))


def rigid_tie(bricks: Bricks, free: Int[np.ndarray, " f"], centre: Float[np.ndarray, " 3"]) -> csr_array:
    """Matrix from small unknowns to nodal displacements; pit nodes follow shift + rotation x arm."""
    f, pit = len(free), bricks.pit_nodes
    axes = np.arange(3)
    own_rows = (3 * free[:, None] + axes).ravel()
    arms = bricks.nodes_mm[pit] - centre
    turn = np.zeros((len(pit), 3, 3))
    turn[:, 0, 1], turn[:, 0, 2] = arms[:, 2], -arms[:, 1]
    turn[:, 1, 0], turn[:, 1, 2] = -arms[:, 2], arms[:, 0]
    turn[:, 2, 0], turn[:, 2, 1] = arms[:, 1], -arms[:, 0]
    pit_rows = 3 * pit[:, None] + axes
    rows = np.concatenate([own_rows, pit_rows.ravel(), np.repeat(pit_rows, 3, axis=1).ravel()])
    columns = np.concatenate(
        [np.arange(3 * f), np.tile(3 * f + axes, len(pit)), np.tile(3 * f + 3 + axes, 3 * len(pit))]
    )
    values = np.concatenate([np.ones(3 * f + 3 * len(pit)), turn.ravel()])
    tie = csr_array(coo_array((values, (rows, columns)), shape=(3 * len(bricks.nodes_mm), 3 * f + 6)))
    return tie if bricks.follows is None else csr_array(kron(bricks.follows, eye_array(3)) @ tie)

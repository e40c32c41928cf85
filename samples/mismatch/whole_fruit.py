"""Every node of a fruit, not its skin alone: gradients in the flesh, forces back from stress there."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from fem.sparse.solver import Factor, factorise
from samples.brick_flesh import BrickFlesh
from samples.mismatch.skin_compliance import SkinCompliance, compliance_of

PointStress = Callable[[Float[np.ndarray, "m 27 3 3"]], Float[np.ndarray, "m 27 3 3"]]
"""Stress (MPa) at the integration points for the displacement gradients there."""


@dataclass(frozen=True, kw_only=True)
class WholeFruit:
    """Flesh with its factorised stiffness, and its patches' compliance.

    `stiffness`: the one that is factorised, near that of the flesh at rest. `support`: stiffness of a skin or
    of springs, linear in the unknowns. `slopes`: gradients of the shape functions at the integration points,
    three rows for each.
    """

    flesh: BrickFlesh
    factor: Factor
    compliance: SkinCompliance
    stiffness: csr_array
    support: csr_array | None
    slopes: Float[np.ndarray, "m 81 27"]
    dofs: Int[np.ndarray, " d"]

    def excess(self, q: Float[np.ndarray, " u"], stress: PointStress) -> Float[np.ndarray, " u"]:
        """Internal forces on the unknowns of the `stress` of the displacement gradient and of what else holds
        the fruit, less those of the factorised stiffness; the pit turns through any angle.
        """
        nodal = self._nodal_force(stress(self._gradients(self.flesh.displacement(q))))
        force = self.flesh.on_unknowns(nodal, q) - self.stiffness @ q
        return np.asarray(force if self.support is None else force + self.support @ q)

    def _gradients(self, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 27 3 3"]:
        """Displacement gradient du_i/dx_k at the integration points."""
        gradients = np.matmul(self.slopes, u[self.flesh.bricks.cells])
        return np.asarray(gradients.reshape(-1, 27, 3, 3).transpose(0, 1, 3, 2))

    def _nodal_force(self, stress: Float[np.ndarray, "m 27 3 3"]) -> Float[np.ndarray, "n 3"]:
        """Forces on the nodes of a stress field P_ik (first index the force's)."""
        cells = self.flesh.bricks.cells
        m = len(cells)
        weighted = stress.transpose(0, 1, 3, 2) * self.flesh.volumes[..., None, None]
        local = np.matmul(self.slopes.transpose(0, 2, 1), weighted.reshape(m, 81, 3))
        count = len(self.flesh.bricks.nodes_mm)
        nodal = [np.bincount(cells.ravel(), local[..., i].ravel(), minlength=count) for i in range(3)]
        return np.stack(nodal, axis=1)

    def solve(self, force_N: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
        """Displacement of all unknowns under forces on them."""
        return self.factor.solve(force_N[:, None])[:, 0]

    def solve_skin(self, force_N: Float[np.ndarray, " u"]) -> Float[np.ndarray, " d"]:
        """Displacement of the patches' unknowns alone, under forces on all unknowns."""
        return self.factor.solve_at(force_N[:, None], self.dofs)[:, 0]

    def spread(self, force_N: Float[np.ndarray, " d"]) -> Float[np.ndarray, " u"]:
        """Forces on the patches' unknowns as forces on all."""
        full = np.zeros(self.flesh.unknowns)
        full[self.dofs] = force_N
        return full


def whole_fruit(
    flesh: BrickFlesh,
    dofs: Int[np.ndarray, " d"],
    *,
    stiffness: csr_array | None = None,
    support: csr_array | None = None,
) -> WholeFruit:
    """Factorise the flesh's stiffness at rest (None: plain flesh's) plus that of a skin or springs."""
    whole = flesh.stiffness if stiffness is None else stiffness
    if support is not None:
        whole = csr_array(whole + support)
    factor = factorise(whole)
    slopes = np.ascontiguousarray(flesh.slopes.transpose(0, 1, 3, 2)).reshape(-1, 81, 27)
    return WholeFruit(
        flesh=flesh, factor=factor, compliance=compliance_of(factor, dofs), stiffness=whole, support=support,
        slopes=slopes, dofs=dofs,
    )  # fmt: skip

"""Forces and tangents of T10 flesh at any strain, element by element in batches."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from fem.elements.assembly import ElementPattern
from fem.elements.gradients import slopes_and_volumes
from fem.elements.shape_functions import t10_gradient, tet_quadrature
from fem.materials.law import UnitLaw
from fem.mesh.flesh_mesh import FleshMesh

#: elements in a batch: its data stay in the processor's cache
_FORCE_BATCH, _TANGENT_BATCH = 512, 128


@dataclass(frozen=True)
class FiniteFlesh:
    """The flesh of a mesh under a law for E = 1 MPa; total Lagrangian, all integrals over the shape at rest.

    gradient[m, a, j, q] = dN_a/dX_j at point q of element m; measure: volume of each point, mm3.
    """

    law: UnitLaw
    tets: Int[np.ndarray, "m 10"]
    n_nodes: int
    gradient: Float[np.ndarray, "m 10 3 q"]
    measure: Float[np.ndarray, "m q"]
    pattern: ElementPattern

    @classmethod
    def of(cls, mesh: FleshMesh, law: UnitLaw, *, degree: Literal[2, 5] = 5) -> "FiniteFlesh":
        """Gradients at the points of every element (14, or 4 for degree 2), and the stiffness's pattern."""
        points, weights = tet_quadrature(degree)
        reference, n, m = t10_gradient(points), len(mesh.nodes_mm), len(mesh.tets)
        gradient, measure = np.empty((m, 10, 3, len(weights))), np.empty((m, len(weights)))
        for part in _parts(m, _FORCE_BATCH):
            slope, det = slopes_and_volumes(mesh.nodes_mm[mesh.tets[part]], reference)
            measure[part], gradient[part] = det * weights, slope.transpose(0, 3, 2, 1)
        return cls(law, mesh.tets, n, gradient, measure, ElementPattern.of(mesh.tets, n))

    def force_N(self, displacement_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Nodal forces that hold the flesh in this displacement, for E = 1 MPa; NaN if inverted."""
        force = np.empty((len(self.tets), 3, 10))
        for part in _parts(len(self.tets), _FORCE_BATCH):
            stress = np.moveaxis(self.law.stress(self._deformation(displacement_mm, part)), 0, -1)
            measure = self.measure[part]
            weighed = (stress * measure.ravel()).reshape(3, 3, *measure.shape).transpose(2, 0, 1, 3)
            flat = self.gradient[part].reshape(len(measure), 10, -1)
            force[part] = weighed.reshape(len(measure), 3, -1) @ flat.transpose(0, 2, 1)
        nodes = self.tets.ravel()
        each = force.transpose(1, 0, 2).reshape(3, -1)
        return np.stack([np.bincount(nodes, weights=row, minlength=self.n_nodes) for row in each], axis=1)

    def stiffness(self, displacement_mm: Float[np.ndarray, "n 3"]) -> csr_array:
        """d force / d displacement (3 n, 3 n), N/mm; its pattern is the same for every displacement."""
        elements = np.empty((len(self.tets), 30, 30))
        for part in _parts(len(self.tets), _TANGENT_BATCH):
            count = len(self.tets[part])
            A = np.moveaxis(self.law.tangent(self._deformation(displacement_mm, part)), 0, -1)
            A = (A * self.measure[part].ravel()).reshape(9, 3, 3, count, -1)
            gradient = self.gradient[part]
            # (i j), k, l, m, q  and  m, b, l, q  ->  m, (j q), (i k b)
            half = np.einsum("ijklmq,mblq->mjqikb", A.reshape(3, 3, 3, 3, count, -1), gradient, optimize=True)
            flat = gradient.reshape(count, 10, -1) @ half.reshape(count, gradient.shape[2] * A.shape[-1], 90)
            elements[part] = flat.reshape(count, 10, 3, 3, 10).swapaxes(3, 4).reshape(count, 30, 30)
        return self.pattern.matrix(elements)

    def _deformation(
        self, displacement_mm: Float[np.ndarray, "n 3"], part: slice
    ) -> Float[np.ndarray, "p 3 3"]:
        """F at the points of some elements, its components stored one by one."""
        gradient = self.gradient[part]
        local = displacement_mm[self.tets[part]].transpose(0, 2, 1) @ gradient.reshape(len(gradient), 10, -1)
        F = np.ascontiguousarray(local.reshape(len(gradient), 3, 3, -1).transpose(1, 2, 0, 3))
        for i in range(3):
            F[i, i] += 1
        return np.moveaxis(F.reshape(3, 3, -1), -1, 0)


def _parts(count: int, size: int) -> Iterator[slice]:
    return (slice(start, start + size) for start in range(0, count, size))

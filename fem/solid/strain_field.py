"""Strains of the whole flesh from nodal displacements, and forces on its nodes from stresses.

An effect inside the fruit changes the stress at each point. B' sigma gives its nodal forces, and the
factorised stiffness of the plain model gives their displacement at the pads. Stresses and strains are
symmetric: six numbers, xx, yy, zz, yz, xz, xy, the shear parts of a strain counted once (not doubled).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from fem.elements.assembly import unit_lame_constants
from fem.elements.gradients import slopes_and_volumes
from fem.elements.shape_functions import t10_gradient, t10_shape
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.recovery import FOUR

ROW, COLUMN = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])
"""Axes of the six, xx, yy, zz, yz, xz, xy."""
COUNT = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""How often each of the six counts in a double contraction."""
PLACE = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
"""Which of the six is at each place of the 3 by 3 tensor."""

_BATCH = 2048
"""Elements processed at once, to limit memory."""


@dataclass(frozen=True, kw_only=True)
class FleshStrain:
    """Four points in each of m elements: `slope` dN/dx, `volume_mm3` of each point, `gather` to nodes."""

    n_nodes: int
    point_mm: Float[np.ndarray, "m 4 3"]
    volume_mm3: Float[np.ndarray, "m 4"]
    slope: Float[np.ndarray, "m 4 3 10"]
    mesh: FleshMesh
    gather: csr_array

    @classmethod
    def of(cls, mesh: FleshMesh) -> "FleshStrain":
        """The points of a mesh; exact for strains that are linear in straight elements."""
        x = mesh.nodes_mm[mesh.tets]
        slope, det = slopes_and_volumes(x, t10_gradient(FOUR[:, 1:]))
        rows = mesh.tets.ravel()
        return cls(
            n_nodes=len(mesh.nodes_mm),
            point_mm=t10_shape(FOUR[:, 1:]) @ x,
            volume_mm3=det / 24,
            slope=slope,
            mesh=mesh,
            gather=csr_array(
                (np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(len(mesh.nodes_mm), len(rows))
            ),
        )

    def strain(self, displacement: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f m 4 6"]:
        """Small strains of displacement fields."""
        count = len(displacement)
        nodal = np.moveaxis(displacement, 0, 1).reshape(self.n_nodes, -1)
        strains = np.empty((count, len(self.slope), 4, 6))
        for part in self._batches():
            slope = self.slope[part].reshape(-1, 12, 10)
            gradient = (slope @ nodal[self.mesh.tets[part]]).reshape(len(slope), 4, 3, count, 3)
            strain = (gradient[:, :, ROW, :, COLUMN] + gradient[:, :, COLUMN, :, ROW]) / 2  # (6, m, 4, f)
            strains[:, part] = np.moveaxis(strain, (0, 3), (3, 0))
        return strains

    def forces(self, stress: Float[np.ndarray, "f m 4 6"]) -> Float[np.ndarray, "f n 3"]:
        """B' sigma: the nodal forces that stress fields exert, sum of sigma : grad N."""
        count = len(stress)
        by_element = np.empty((len(self.slope), 10, 3 * count))
        for part in self._batches():
            held = stress[:, part] * self.volume_mm3[part, :, None]
            flux = np.moveaxis(held, 0, -1)[:, :, PLACE]  # (m, 4, 3, 3, f)
            slope = self.slope[part].reshape(-1, 12, 10)
            by_element[part] = np.swapaxes(slope, 1, 2) @ flux.reshape(len(slope), 12, 3 * count)
        summed = (self.gather @ by_element.reshape(-1, 3 * count)).reshape(self.n_nodes, 3, count)
        return np.ascontiguousarray(np.moveaxis(summed, 2, 0))

    def _batches(self) -> list[slice]:
        return [slice(start, start + _BATCH) for start in range(0, len(self.slope), _BATCH)]


def elastic_stress(strain: Float[np.ndarray, "*b 6"], *, poisson_ratio: float) -> Float[np.ndarray, "*b 6"]:
    """2 mu eps + lambda tr(eps) I for E = 1 MPa.

    Uniaxial strain at nu = 1/4: the axial stress is 1.2 E times the strain.

    >>> elastic_stress(np.array([1.0, 0, 0, 0, 0, 0]), poisson_ratio=0.25)
    array([1.2, 0.4, 0.4, 0. , 0. , 0. ])
    """
    mu, lame = unit_lame_constants(poisson_ratio)
    stress = 2 * mu * strain
    stress[..., :3] += lame * strain[..., :3].sum(axis=-1, keepdims=True)
    return np.asarray(stress)

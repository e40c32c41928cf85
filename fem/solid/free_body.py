"""A body held by nothing: resultants of loads, their balance, and displacements without a rigid part."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import lumped_moments
from fem.solid.rigid_core import rigid_modes

if TYPE_CHECKING:
    from fem.mesh.flesh_mesh import FleshMesh


@dataclass(frozen=True)
class FreeBody:
    """Rigid motions R (3 n, 6) about the flesh's centroid, and M R, the body forces in their likeness.

    M is the mass matrix for unit density. With P = I - R (R' M R)^-1 R' M, a load f is balanced by P' f
    (the body forces of a rigid acceleration), and P u is u without its mean rigid motion. Both together
    make the compliance P K^- P' symmetric and independent of how the rigid motion was held.
    """

    modes: Float[np.ndarray, "d 6"]
    body_forces: Float[np.ndarray, "d 6"]
    inertia: Float[np.ndarray, "6 6"]

    @classmethod
    def of(cls, mesh: "FleshMesh") -> "FreeBody":
        """The rigid motions of the flesh of a mesh (the pit is without mass)."""
        moments = lumped_moments(mesh.nodes_mm, mesh.tets)
        centre_mm = moments[:, 1:].sum(axis=0) / moments[:, 0].sum()
        modes = rigid_modes(mesh.nodes_mm, centre_mm=centre_mm).reshape(-1, 6)
        # M (w x (x - c)) at a node is w x (integral of N x - c integral of N)
        forces = rigid_modes(moments[:, 1:] - moments[:, :1] * centre_mm, centre_mm=np.zeros(3))
        forces[:, :, :3] *= moments[:, :1, None]
        body_forces = forces.reshape(-1, 6)
        return cls(modes, body_forces, modes.T @ body_forces)

    def acceleration(self, load_N: Float[np.ndarray, "d f"]) -> Float[np.ndarray, "6 f"]:
        """(R' M R)^-1 R' f: amounts of the body forces that each load is balanced by."""
        return np.asarray(np.linalg.solve(self.inertia, self.modes.T @ load_N))

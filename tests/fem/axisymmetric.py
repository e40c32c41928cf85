"""Bodies of revolution in quadratic quadrilaterals: the truth that estimates with tetrahedra are held
against.

Two dimensions make it cheap to be exact: a fine mesh has a few thousand nodes. Nothing of fem is used.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import spsolve


def lagrange(x):
    """The three quadratic polynomials on [-1, 1] and their slopes, at points x: (3, p) each."""
    return (
        np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2]),
        np.stack([x - 0.5, -2 * x, x + 0.5]),
    )


@dataclass(frozen=True)
class Revolved:
    """A grid of nodes (2 m + 1, 2 n + 1, 2), lengths r and z; the row [:, -1] is the loaded surface.

    `fixed` says which of a node's two displacements are zero.
    """

    nodes: np.ndarray
    fixed: np.ndarray
    nu: float

    @property
    def elements(self):
        rows, columns = self.nodes.shape[:2]
        number = np.arange(rows * columns).reshape(rows, columns)
        corner = number[:-2:2, :-2:2].reshape(-1, 1)
        return corner + np.add.outer(np.arange(3) * columns, np.arange(3)).ravel()

    def stiffness(self):
        """For unit modulus; strains rr, zz, tt, rz."""
        at, weight = np.polynomial.legendre.leggauss(3)
        value, slope = lagrange(at)
        shape = np.einsum("ip,jq->pqij", value, value).reshape(9, 9)
        local = np.stack([np.einsum("ip,jq->pqij", slope, value), np.einsum("ip,jq->pqij", value, slope)])
        local = local.reshape(2, 9, 9)
        x = self.nodes.reshape(-1, 2)[self.elements]
        jacobian = np.einsum("dpa,eax->epdx", local, x)
        gradient = np.einsum("epxd,dpa->epxa", np.linalg.inv(jacobian), local)
        radius = np.einsum("pa,ea->ep", shape, x[:, :, 0])
        volume = 2 * np.pi * radius * np.abs(np.linalg.det(jacobian)) * np.outer(weight, weight).ravel()
        strain = np.zeros((*gradient.shape[:2], 4, 9, 2))
        strain[:, :, 0, :, 0] = strain[:, :, 3, :, 1] = gradient[:, :, 0]
        strain[:, :, 1, :, 1] = strain[:, :, 3, :, 0] = gradient[:, :, 1]
        strain[:, :, 2, :, 0] = shape / radius[:, :, None]
        strain = strain.reshape(*gradient.shape[:2], 4, 18)
        law = np.zeros((4, 4))
        law[:3, :3] = self.nu / ((1 + self.nu) * (1 - 2 * self.nu))
        law += np.diag([1.0, 1.0, 1.0, 0.5]) / (1 + self.nu)
        blocks = np.einsum("ep,epki,kl,eplj->eij", volume, strain, law, strain, optimize=True)
        dof = (2 * self.elements[:, :, None] + np.arange(2)).reshape(len(x), 18)
        size = 2 * self.nodes[..., 0].size
        pairs = (np.repeat(dof, 18, axis=1).ravel(), np.tile(dof, (1, 18)).ravel())
        return csr_array(coo_array((blocks.ravel(), pairs), shape=(size, size)))

    def surface_displacement(self, traction_z):
        """Displacement (t, 2 m + 1, 2) of the loaded surface under tractions along z, functions of r."""
        edge = self.nodes[:, -1]
        at, weight = np.polynomial.legendre.leggauss(5)
        value, slope = lagrange(at)
        spans = np.stack([edge[k : k + 3] for k in range(0, len(edge) - 2, 2)])
        place = np.einsum("ap,eax->epx", value, spans)
        length = np.linalg.norm(np.einsum("ap,eax->epx", slope, spans), axis=2)
        ring = 2 * np.pi * place[:, :, 0] * length * weight
        load = np.zeros((*self.nodes.shape[:2], 2, len(traction_z)))
        for frame, traction in enumerate(traction_z):
            nodal = np.einsum("ep,ap->ea", ring * traction(place[:, :, 0]), value)
            for a in range(3):
                np.add.at(load[:, -1, 1, frame], 2 * np.arange(len(spans)) + a, nodal[:, a])
        free = np.flatnonzero(~self.fixed.ravel())
        moved = np.zeros((self.fixed.size, len(traction_z)))
        matrix = self.stiffness()[free][:, free].tocsc()
        moved[free] = spsolve(matrix, load.reshape(-1, len(traction_z))[free])
        return np.moveaxis(moved.reshape(*self.nodes.shape[:2], 2, -1)[:, -1], -1, 0)


def cored_ball(radius_mm: float, core_mm: float, nu: float) -> Revolved:
    """The upper half of a ball around a rigid concentric core, pressed alike from above and below."""
    angle = np.pi / 2 * np.linspace(0, 1, 81) ** 1.5
    depth = np.linspace(1, 0, 41) ** 1.5
    ray = radius_mm - (radius_mm - core_mm) * depth
    nodes = np.stack([np.outer(np.sin(angle), ray), np.outer(np.cos(angle), ray)], axis=-1)
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[0, :, 0] = True
    fixed[-1, :, 1] = True
    fixed[:, 0] = True
    return Revolved(nodes, fixed, nu)


def cylinder(radius_mm: float, height_mm: float, nu: float) -> Revolved:
    """A cylinder from z = 0, where it is held, to its pressed top."""
    across = radius_mm * np.linspace(0, 1, 81) ** 1.3
    up = height_mm * (1 - np.linspace(1, 0, 41) ** 1.5)
    nodes = np.stack(np.broadcast_arrays(across[:, None], up[None]), axis=-1)
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[0, :, 0] = True
    fixed[:, 0] = True
    return Revolved(nodes, fixed, nu)

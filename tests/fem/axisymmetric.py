"""Bodies of revolution in quadratic quadrilaterals: the truth that estimates with tetrahedra are held
against.

Two dimensions make it cheap to be exact: a fine mesh has a few thousand nodes. Nothing of fem is used.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import spsolve


def lagrange(x):
    """The three quadratic polynomials on [-1, 1] and their slopes, at points x: (3, p) each."""
    return (np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2]), np.stack([x - 0.5, -2 * x, x + 0.5]))


@dataclass(frozen=True)
class RingElements:
    """Nine-node quadrilaterals of revolution: degrees of freedom, volumes, gradients and shapes over radius.

    `gradient` (e, p, 2, 9) along r and z, `around` (e, p, 9), at the points p of each element e.
    """

    dof: np.ndarray
    volume: np.ndarray
    gradient: np.ndarray
    around: np.ndarray

    @classmethod
    def of(cls, nodes):
        """On a grid of nodes (2 m + 1, 2 n + 1, 2), lengths r and z."""
        across, up = nodes.shape[:2]
        corner = np.arange(across * up).reshape(across, up)[:-2:2, :-2:2].reshape(-1, 1)
        elements = corner + np.add.outer(np.arange(3) * up, np.arange(3)).ravel()
        at, weight = np.polynomial.legendre.leggauss(3)
        value, slope = lagrange(at)
        shape = np.einsum("ip,jq->pqij", value, value).reshape(9, 9)
        local = np.stack([np.einsum("ip,jq->pqij", slope, value), np.einsum("ip,jq->pqij", value, slope)])
        place = nodes.reshape(-1, 2)[elements]
        jacobian = np.einsum("dpa,eax->epdx", local.reshape(2, 9, 9), place)
        gradient = np.einsum("epxd,dpa->epxa", np.linalg.inv(jacobian), local.reshape(2, 9, 9))
        radius = np.einsum("pa,ea->ep", shape, place[:, :, 0])
        volume = 2 * np.pi * radius * np.abs(np.linalg.det(jacobian)) * np.outer(weight, weight).ravel()
        dof = (2 * elements[:, :, None] + np.arange(2)).reshape(len(elements), 18)
        return cls(dof, volume, gradient, shape / radius[:, :, None])

    def strains(self):
        """rr, zz, tt, rz (doubled) of each degree of freedom, (e, p, 4, 18)."""
        B = np.zeros((*self.volume.shape, 4, 9, 2))
        B[:, :, 0, :, 0] = B[:, :, 3, :, 1] = self.gradient[:, :, 0]
        B[:, :, 1, :, 1] = B[:, :, 3, :, 0] = self.gradient[:, :, 1]
        B[:, :, 2, :, 0] = self.around
        return B.reshape(*self.volume.shape, 4, 18)

    def assembled(self, blocks, size):
        """Elements' matrices (e, 18, 18) in one of `size` rows."""
        pairs = (np.repeat(self.dof, 18, axis=1).ravel(), np.tile(self.dof, (1, 18)).ravel())
        return csc_array(coo_array((blocks.ravel(), pairs), shape=(size, size)))


@dataclass(frozen=True)
class Revolved:
    """A grid of nodes (2 m + 1, 2 n + 1, 2), lengths r and z; the row [:, -1] is the loaded surface.

    `fixed` says which of a node's two displacements are zero.
    """

    nodes: np.ndarray
    fixed: np.ndarray
    nu: float

    def stiffness(self):
        """For unit modulus."""
        ring = RingElements.of(self.nodes)
        strain = ring.strains()
        law = np.zeros((4, 4))
        law[:3, :3] = self.nu / ((1 + self.nu) * (1 - 2 * self.nu))
        law += np.diag([1.0, 1.0, 1.0, 0.5]) / (1 + self.nu)
        blocks = np.einsum("ep,epki,kl,eplj->eij", ring.volume, strain, law, strain, optimize=True)
        return ring.assembled(blocks, self.nodes.size)

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
        matrix = self.stiffness()[free][:, free]
        moved[free] = spsolve(matrix, load.reshape(-1, len(traction_z))[free])
        return np.moveaxis(moved.reshape(*self.nodes.shape[:2], 2, -1)[:, -1], -1, 0)


def fixed_axis(nodes):
    """Displacements that are zero: along r on the axis, both at the first node of each row."""
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[0, :, 0] = True
    fixed[:, 0] = True
    return fixed


def cored_ball(radius_mm: float, core_mm: float, nu: float) -> Revolved:
    """The upper half of a ball around a rigid concentric core, pressed alike from above and below."""
    angle = np.pi / 2 * np.linspace(0, 1, 81) ** 1.5
    depth = np.linspace(1, 0, 41) ** 1.5
    ray = radius_mm - (radius_mm - core_mm) * depth
    nodes = np.stack([np.outer(np.sin(angle), ray), np.outer(np.cos(angle), ray)], axis=-1)
    fixed = fixed_axis(nodes)
    fixed[-1, :, 1] = True
    return Revolved(nodes, fixed, nu)


def cylinder(radius_mm: float, height_mm: float, nu: float) -> Revolved:
    """A cylinder from z = 0, where it is held, to its pressed top."""
    across = radius_mm * np.linspace(0, 1, 81) ** 1.3
    up = height_mm * (1 - np.linspace(1, 0, 41) ** 1.5)
    nodes = np.stack(np.broadcast_arrays(across[:, None], up[None]), axis=-1)
    return Revolved(nodes, fixed_axis(nodes), nu)

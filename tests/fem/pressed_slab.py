"""A slab under a rigid ball in axisymmetric finite elements: the truth for a bare indenter's traces.

Quadratic quadrilaterals, Newton's method, node-wise frictionless contact. Nothing of fem is used: no Hertz,
no springs. The flesh is linear or plastic (strains rr, zz, tt, rz; the last doubled).
`git show 7b360655:tests/fem/pressed_slab.py` wrote tests/data/pressed-slab.csv, with two more laws.
"""

from dataclasses import dataclass, field

import numpy as np
from axisymmetric import RingElements, fixed_axis
from scipy.sparse.linalg import splu

TRACE = np.array([1.0, 1.0, 1.0, 0.0])


def elastic(E, nu):
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    return lam * np.outer(TRACE, TRACE) + mu * np.diag([2.0, 2.0, 2.0, 1.0])


@dataclass
class Linear:
    E: float = 1.0
    nu: float = 0.45

    def __post_init__(self):
        self.C = elastic(self.E, self.nu)
        self.mu = self.E / (2 * (1 + self.nu))

    def stress(self, strain):
        """Stress and its slope at every point."""
        return strain @ self.C, np.broadcast_to(self.C, (*strain.shape, 4))

    def settle(self, strain):
        """The step is done: remember."""

    def energy(self, strain):
        return np.einsum("...i,...i->...", strain @ self.C, strain) / 2


@dataclass
class Plastic(Linear):
    """Perfect von Mises plasticity with a little hardening, by radial return."""

    yield_MPa: float = 1.0
    hardening: float = 0.01
    set_: np.ndarray | float = 0.0
    run: np.ndarray | float = 0.0
    trial: tuple = field(default=(), repr=False)

    def stress(self, strain):
        tensor = np.array([1.0, 1.0, 1.0, 0.5])
        free = strain - self.set_
        even = free[..., :3].sum(-1)[..., None] * TRACE
        bulk = self.C[0, 1] + 2 * self.mu / 3
        shear = 2 * self.mu * (free - even / 3) * tensor
        size = np.sqrt((shear[..., :3] ** 2).sum(-1) + 2 * shear[..., 3] ** 2)
        H = self.hardening * self.E
        limit = np.sqrt(2 / 3) * (self.yield_MPa + H * self.run)
        flow = np.maximum(size - limit, 0) / (2 * self.mu + 2 / 3 * H)
        way = shear / np.maximum(size, 1e-30)[..., None]
        self.trial = (flow[..., None] * way / tensor, np.sqrt(2 / 3) * flow)
        stress = bulk * even + shear - 2 * self.mu * flow[..., None] * way
        left = np.where(flow > 0, 1 - 2 * self.mu * flow / np.maximum(size, 1e-30), 1.0)
        bend = np.where(flow > 0, 1 / (1 + H / (3 * self.mu)) - (1 - left), 0.0)
        slope = bulk * np.outer(TRACE, TRACE) + left[..., None, None] * (
            self.C - bulk * np.outer(TRACE, TRACE)
        )
        slope = slope - 2 * self.mu * bend[..., None, None] * way[..., :, None] * way[..., None, :]
        return stress, slope

    def settle(self, strain):
        self.stress(strain)
        self.set_ = self.set_ + self.trial[0]
        self.run = self.run + self.trial[1]


@dataclass
class PressedSlab:
    """A disc `wide_mm` in radius, `thick_mm` high, bonded to its base, under a ball of `radius_mm`."""

    radius_mm: float
    thick_mm: float
    wide_mm: float
    contact_mm: float
    law: Linear
    across: int = 22
    down: int = 16

    def __post_init__(self):
        fine = 1.6 * self.contact_mm * np.linspace(0, 1, self.across + 1) ** 1.2
        ratio = np.geomspace(1, (self.wide_mm / fine[-1]), 17)[1:]
        r = np.r_[fine, fine[-1] * ratio]
        r = np.interp(np.arange(2 * len(r) - 1) / 2, np.arange(len(r)), r)
        x = np.linspace(0, 1, 2 * self.down + 1)
        z = self.thick_mm * (1 - (1 - x) ** 2.2)
        nodes = np.stack(np.broadcast_arrays(r[:, None], z[None]), -1)
        self.ring = RingElements.of(nodes)
        self.dof, self.volume, self.B = self.ring.dof, self.ring.volume, self.ring.strains()
        self.free = ~fixed_axis(nodes).ravel()
        self.top = 2 * np.arange(nodes.size // 2).reshape(nodes.shape[:2])[:, -1] + 1
        self.top = self.top[r < 0.98 * self.radius_mm]
        r = r[r < 0.98 * self.radius_mm]
        self.gap = self.radius_mm - np.sqrt(self.radius_mm**2 - r**2)
        self.u = np.zeros(nodes.size)
        self.touching = np.zeros(len(self.top), dtype=bool)

    def strain(self):
        return np.einsum("epij,ej->epi", self.B, self.u[self.dof])

    def inner(self):
        """What the flesh puts on every dof, and the law's slopes."""
        stress, slope = self.law.stress(self.strain())
        inner = np.zeros(len(self.u))
        np.add.at(inner, self.dof, np.einsum("ep,epij,epi->ej", self.volume, self.B, stress))
        return inner, slope

    def force_at(self, depth_mm):
        """Force on the ball once it is at this depth: one step of history."""
        calm = True
        for _ in range(120):
            inner, slope = self.inner()
            moved, checked = False, calm
            if calm:
                below = self.u[self.top] + depth_mm - self.gap
                touching = np.where(self.touching, -inner[self.top] > -1e-12, below > 1e-9)
                moved = (touching != self.touching).any()
                self.touching = touching
            held = self.top[self.touching]
            free = self.free.copy()
            free[held] = False
            jump = np.zeros(len(self.u))
            jump[held] = self.gap[self.touching] - depth_mm - self.u[held]
            far = np.abs(jump).max() > 1e-9
            left = np.linalg.norm(inner[free]) / (1e-6 + np.abs(inner[self.top]).sum())
            calm = left < 1e-6 and not far
            if calm and checked and not moved:
                break
            blocks = np.einsum("ep,epki,epkl,eplj->eij", self.volume, self.B, slope, self.B, optimize=True)
            K = self.ring.assembled(blocks, len(self.u))
            rhs = -inner - K @ jump
            step = jump
            step[free] = splu(K[free][:, free], permc_spec="MMD_AT_PLUS_A").solve(rhs[free])
            start, size = self.u, np.linalg.norm(inner[free])
            for part in (1.0, 0.5, 0.25, 0.1, 0.03):
                self.u = start + part * step
                if far or np.linalg.norm(self.inner()[0][free]) < size:
                    break
        else:
            raise RuntimeError("the slab did not settle")
        self.law.settle(self.strain())
        return float(-inner[self.top].sum())

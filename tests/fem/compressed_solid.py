"""Solids of revolution squeezed by a rigid tool, in axisymmetric finite elements at finite strain.

Quadratic quadrilaterals in the undeformed shape (total Lagrangian), Newton's method, node-wise frictionless
contact: the truth for spheres and cylinders between plates, for a flat punch and a ball. Nothing of fem is
used. The flesh is a compressible neo-Hookean solid, P = mu (F - F^-T) + lambda ln J F^-T (Bonet and Wood,
"Nonlinear Continuum Mechanics for Finite Element Analysis", 2nd ed., 2008, eq. 6.28), or linear or plastic at
small strain. `git show 7b360655:tests/fem/pressed_slab.py` wrote tests/data/pressed-slab.csv.
"""

from dataclasses import dataclass

import numpy as np
from axisymmetric import RingElements, fixed_axis
from scipy.sparse.linalg import splu

#: F as (rr, rz, zr, zz, tt): row and column in the 3 x 3 tensor with axes r, z, t
ROW, COLUMN = np.array([0, 0, 1, 1, 2]), np.array([0, 1, 0, 1, 2])
ONE = (ROW == COLUMN).astype(float)
TURNED = np.array([0, 2, 1, 3, 4])


def lame(nu):
    """For E = 1."""
    return nu / ((1 + nu) * (1 - 2 * nu)), 1 / (2 * (1 + nu))


def neo_hookean(change, nu):
    """First Piola stress and its slope, from F - 1 (n, p, 5)."""
    lam, mu = lame(nu)
    F = np.zeros((*change.shape[:-1], 3, 3))
    F[..., ROW, COLUMN] = change + ONE
    J = np.linalg.det(F)
    if not (J > 0).all():
        return np.full_like(change, np.nan), None
    G = np.linalg.inv(F)
    GT = np.swapaxes(G, -1, -2)
    log = np.log(J)[..., None]
    P = mu * F + (lam * log - mu)[..., None] * GT
    inverse_t = GT[..., ROW, COLUMN]
    crossed = GT[..., ROW[:, None], COLUMN[None, :]] * GT[..., ROW[None, :], COLUMN[:, None]]
    slope = (
        mu * np.eye(5)
        + (mu - lam * log)[..., None] * crossed
        + lam * inverse_t[..., :, None] * inverse_t[..., None, :]
    )
    return P[..., ROW, COLUMN], slope


def linear(change, nu):
    """The same at small strain."""
    lam, mu = lame(nu)
    C = lam * np.outer(ONE, ONE) + mu * np.eye(5) + mu * np.eye(5)[TURNED]
    return change @ C, np.broadcast_to(C, (*change.shape, 5))


class Plastic:
    """Perfect von Mises plasticity with a little hardening, by radial return, at small strain."""

    def __init__(self, yield_MPa, hardening=0.01):
        self.yield_MPa, self.hardening = yield_MPa, hardening
        self.set_, self.run = 0.0, 0.0

    def __call__(self, change, nu):
        lam, mu = lame(nu)
        bulk, H = (lam + 2 / 3 * mu) * np.outer(ONE, ONE), self.hardening
        free = (change + change[..., TURNED]) / 2 - self.set_
        shear = 2 * mu * (free - (free @ ONE)[..., None] * ONE / 3)
        size = np.maximum(np.linalg.norm(shear, axis=-1), 1e-30)
        limit = np.sqrt(2 / 3) * (self.yield_MPa + H * self.run)
        flow = np.maximum(size - limit, 0) / (2 * mu + 2 / 3 * H)
        way = shear / size[..., None]
        self.trial = flow[..., None] * way, np.sqrt(2 / 3) * flow
        left = 1 - 2 * mu * flow / size
        bend = np.where(flow > 0, 1 / (1 + H / (3 * mu)) - (1 - left), 0.0)
        slope = bulk + left[..., None, None] * (linear(change, nu)[1] - bulk)
        slope = slope - 2 * mu * bend[..., None, None] * way[..., :, None] * way[..., None, :]
        return free @ bulk + left[..., None] * shear, slope

    def settle(self):
        """The step is done: remember."""
        self.set_, self.run = self.set_ + self.trial[0], self.run + self.trial[1]


@dataclass
class CompressedSolid:
    """A grid of nodes (2 m + 1, 2 n + 1, 2) of lengths r and z, E = 1.

    `fixed` (like nodes): displacements that are zero. `tool`: numbers of the nodes that a tool, coming down
    along z, can touch; it holds those that are `bonded` (one truth value, or one for each). `gap`: how far
    the tool lies above its lowest place there.
    """

    nodes: np.ndarray
    fixed: np.ndarray
    tool: np.ndarray
    nu: float
    law: object = neo_hookean
    bonded: object = False
    gap: np.ndarray | float = 0.0

    def __post_init__(self):
        self.ring = RingElements.of(self.nodes)
        self.dof, self.volume = self.ring.dof, self.ring.volume
        B = np.zeros((*self.volume.shape, 5, 9, 2))
        B[:, :, 0, :, 0] = B[:, :, 2, :, 1] = self.ring.gradient[:, :, 0]
        B[:, :, 1, :, 0] = B[:, :, 3, :, 1] = self.ring.gradient[:, :, 1]
        B[:, :, 4, :, 0] = self.ring.around
        self.B = B.reshape(*self.volume.shape, 5, 18)
        self.free = ~self.fixed.reshape(-1)
        self.down = 2 * self.tool + 1
        self.height = self.nodes.reshape(-1, 2)[self.tool, 1] - self.gap
        self.face = self.height.max()
        self.u = np.zeros(self.nodes.size)
        self.always = np.broadcast_to(self.bonded, len(self.tool))
        self.touching = self.always.copy()

    def inner(self, u):
        stress, slope = self.law(np.einsum("epij,ej->epi", self.B, u[self.dof], optimize=True), self.nu)
        inner = np.einsum("ep,epij,epi->ej", self.volume, self.B, stress, optimize=True)
        return np.bincount(self.dof.ravel(), inner.ravel(), len(u)), slope

    def force_at(self, face_z, *, halvings=3):
        """Force on the tool once its face is at this height; in smaller steps where one is too large."""
        kept = self.u.copy(), self.touching.copy()
        try:
            return self._force_at(face_z)
        except RuntimeError:
            if not halvings:
                raise
        self.u, self.touching = kept
        self.force_at((self.face + face_z) / 2, halvings=halvings - 1)
        return self.force_at(face_z, halvings=halvings - 1)

    def _force_at(self, face_z):
        for turn in range(120):
            inner, slope = self.inner(self.u)
            held = self.down[self.touching]
            jump = np.zeros(len(self.u))
            jump[held] = (face_z - self.height - self.u[self.down])[self.touching]
            free = self.free.copy()
            free[held] = False
            size, far = np.linalg.norm(inner[free]), np.abs(jump).max() > 1e-10
            balanced = size < 1e-7 * (1e-6 + np.abs(inner[self.down]).sum()) and not far
            if balanced:
                above = self.height + self.u[self.down] - face_z
                held_on = self.touching & (self.always | (-inner[self.down] > -1e-12))
                touching = held_on | (~self.touching & (above > 1e-10))
                if (touching == self.touching).all():
                    break
                if turn > 60:  # nodes at the rim that come and go
                    raise RuntimeError("the contact did not settle")
                self.touching = touching
                continue
            blocks = np.einsum("ep,epki,epkl,eplj->eij", self.volume, self.B, slope, self.B, optimize=True)
            K = self.ring.assembled(blocks, len(self.u))
            rhs = -inner - K @ jump
            step = jump
            step[free] = splu(K[free][:, free], permc_spec="MMD_AT_PLUS_A").solve(rhs[free])
            for part in (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 0.003):
                after = self.inner(self.u + part * step)[0]
                if np.isfinite(after).all() and (far or np.linalg.norm(after[free]) < size):
                    break
            else:
                raise RuntimeError("no step is short enough")
            self.u = self.u + part * step
        else:
            raise RuntimeError("the solid did not settle")
        if isinstance(self.law, Plastic):
            self.law.settle()
        self.face = face_z
        return float(-inner[self.down].sum())


def _between(corners):
    """Corners of elements with their middles: (m + 1) -> (2 m + 1)."""
    corners = np.asarray(corners)
    return np.interp(np.arange(2 * len(corners) - 1) / 2, np.arange(len(corners)), corners)


def spheroid(*, nu, across=1.0, along=1.0, pit_share=0.0, round_=28, out=14, law=neo_hookean):
    """Half of a spheroid (radii `across` the axis and `along` it) round a rigid pit of the same shape.

    The axis is that of the plates; z = 0 is the plane of symmetry. Without a pit a void of a fiftieth stands
    in the middle, which 1e-5 of the force does not notice.
    """
    angle = np.pi / 2 * _between(np.linspace(0, 1, round_ + 1) ** 1.6)
    inside = max(pit_share, 0.02)
    size = inside + (1 - inside) * _between(1 - (1 - np.linspace(0, 1, out + 1)) ** 1.5)
    r = across * np.outer(np.sin(angle), size)
    z = along * np.outer(np.cos(angle), size)
    r[0], z[-1] = 0.0, 0.0
    fixed = np.zeros((*r.shape, 2), dtype=bool)
    fixed[0, :, 0] = True
    fixed[-1, :, 1] = True
    if pit_share > 0:
        fixed[:, 0] = True
    number = np.arange(r.size).reshape(r.shape)
    near = angle < 0.45 * np.pi
    return CompressedSolid(nodes=np.stack([r, z], -1), fixed=fixed, tool=number[near, -1], nu=nu, law=law)


def cylinder(*, nu, radius, height, bonded, across=12, up=12, law=neo_hookean, sides_touch=False):
    """Half of a cylinder between plates to which its ends are bonded or on which they slide; z = 0 is the
    middle. Elements are finer at the bonded edge. Bulging sides that reach the plates fold onto them without
    friction if `sides_touch`; otherwise they pass through.
    """
    r = radius * _between(1 - (1 - np.linspace(0, 1, across + 1)) ** 1.7)
    z = height / 2 * _between(1 - (1 - np.linspace(0, 1, up + 1)) ** 1.7)
    nodes = np.stack(np.broadcast_arrays(r[:, None], z[None]), -1)
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[0, :, 0] = True
    fixed[:, 0, 1] = True
    if bonded:
        fixed[:, -1, 0] = True
    number = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
    tool = np.r_[number[:, -1], number[-1, 1:-1]] if sides_touch else number[:, -1]
    held = np.arange(len(tool)) < len(number)
    return CompressedSolid(nodes=nodes, fixed=fixed, tool=tool, nu=nu, law=law, bonded=held)


def punched_slab(*, nu, radius, thickness, wide, inside=14, outside=16, down=14, law=linear):
    """A slab bonded to a rigid base under a frictionless flat-ended punch; elements shrink to its rim."""
    rim = radius * (1 - (1 - np.linspace(0, 1, inside + 1)) ** 2.5)
    first = rim[-1] - rim[-2]
    # widths grow geometrically from the rim's
    ratio = np.linspace(0, 1, outside + 1)
    beyond = radius + first * (np.exp(ratio * np.log1p((wide - radius) / first)) - 1)
    r = _between(np.r_[rim, beyond[1:]])
    x = np.linspace(0, 1, down + 1)
    z = thickness * _between(1 - (np.exp(3.5 * (1 - x)) - 1) / (np.exp(3.5) - 1))
    nodes = np.stack(np.broadcast_arrays(r[:, None], z[None]), -1)
    number = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
    tool = number[r < radius * (1 + 1e-9), -1]
    return CompressedSolid(nodes=nodes, fixed=fixed_axis(nodes), tool=tool, nu=nu, law=law, bonded=True)


def pressed_slab(*, nu, thickness, wide, contact, ball=None, across=20, down=12, law=linear):
    """A slab bonded to a rigid base under a frictionless ball of that radius; without one, a flat end of
    1.6 `contact` holds on to it.
    """
    fine = 1.6 * contact * np.linspace(0, 1, across + 1) ** 1.2
    r = _between(np.r_[fine, np.geomspace(fine[-1], wide, 17)[1:]])
    z = thickness * (1 - (1 - np.linspace(0, 1, 2 * down + 1)) ** 2.2)
    nodes = np.stack(np.broadcast_arrays(r[:, None], z[None]), -1)
    near = r <= (fine[-1] if ball is None else 0.98 * ball)
    tool = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])[near, -1]
    gap = 0.0 if ball is None else ball - np.sqrt(ball**2 - r[near] ** 2)
    held = {"law": law, "gap": gap, "bonded": ball is None}
    return CompressedSolid(nodes=nodes, fixed=fixed_axis(nodes), tool=tool, nu=nu, **held)

"""A pit of two rigid halves, parted by a plane through its middle: what their motion adds to a response.

r: motion of one half relative to the other (three translations, three rotations). W_j: displacement of the
whole fruit in equilibrium, without loads, where r_j = 1. With forces f on the skin the plain response U gets
more of W, so much that the halves pass no force or moment to each other but by what joins them, B:

    u = U + W r,      (S + B) r = W' f,      S = W' K0 W,      B = (1 / m - 1) S

for E = 1 MPa; six solves and no new factorisation. B is a bond in proportion to S, by which flesh itself
holds the halves together: they part by the share m of what they would with nothing between them,
r = m S^-1 W' f.
Nothing keeps the halves from moving into each other.

At the edge of the parting plane the displacement passes from one half's to the other's over EDGE_MM of the
pit's surface: a jump of a bonded surface would take endless energy, by the logarithm of its width.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.force_products import ForceNoise
from fem.mismatch.model.forward_model import ForwardModel
from fem.solid.linear_solid import Support, UnitModulusSolid
from fem.solid.rigid_core import pit_centre_mm, rigid_modes

EDGE_MM = 2.0
"""About the distance of the pit's nodes in meshes of fruit, which no jump is sharper than. Set by hand."""


@dataclass(frozen=True)
class PartedPit:
    """`modes`: W S^(-1/2) at the nodes of the skin that a solid numbers (six of them)."""

    modes: Float[np.ndarray, "6 c 3"]

    @classmethod
    def of(cls, solid: UnitModulusSolid, angle_deg: float) -> "PartedPit":
        """Parted by the plane through the pit's middle that holds the stem's axis, z, at this angle to x
        (towards y).
        """
        return cls.each(solid, [angle_deg])[0]

    @classmethod
    def each(cls, solid: UnitModulusSolid, angles_deg: Sequence[float]) -> "list[PartedPit]":
        """`of` at each angle, all of them solved for together.

        S = W' K0 W is V' K0 W, V the motion imposed on the pit: what W has beside it does no work on K0 W.
        """
        mesh = solid.mesh
        pit = mesh.nodes_mm[mesh.pit_nodes]
        centre = pit_centre_mm(mesh.nodes_mm, mesh.pit_nodes)
        angle = np.radians(angles_deg)
        off_plane = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1) @ (pit - centre).T
        second = np.clip(0.5 + off_plane / EDGE_MM, 0.0, 1.0)
        motions = rigid_modes(pit, centre_mm=centre)
        motions[:, :, 3:] /= np.linalg.norm(pit - centre, axis=1).mean()
        imposed = np.zeros((6 * len(angle), *mesh.nodes_mm.shape))
        imposed[:, mesh.pit_nodes] = np.einsum("ap,pxq->aqpx", second, motions).reshape(-1, *pit.shape)
        loads = _forces(solid, imposed)
        moved = imposed - solid.displacement(loads)
        if solid.support == "free":
            still = solid.free_body.without_rigid_motion(moved.reshape(len(moved), -1).T)
            moved = np.ascontiguousarray(still.T).reshape(moved.shape)
        parted = []
        for displacement, load in zip(np.split(moved, len(angle)), np.split(loads, len(angle)), strict=True):
            stiffness = displacement.reshape(6, -1) @ load.reshape(6, -1).T
            factor = np.linalg.cholesky((stiffness + stiffness.T) / 2)
            on_skin = displacement[:, solid.contact_nodes]
            parted.append(cls(np.linalg.solve(factor, on_skin.reshape(6, -1)).reshape(on_skin.shape)))
        return parted

    def at_markers(self, recording: GraspResponse) -> Float[np.ndarray, "6 n 3"]:
        """Its modes at a recording's markers."""
        return recording.at_markers(self.modes)


def parted_pit(forward: ForwardModel, recording: GraspResponse, angle_deg: float) -> PartedPit:
    """Of this recording's support; each angle to a hundredth of a degree is solved for once."""
    solid, angle = forward.base.solid_of(recording), _rounded(angle_deg)
    known = _known(forward, solid.support)
    if angle not in known:
        known[angle] = PartedPit.of(solid, angle)
    return known[angle]


def part_together(forward: ForwardModel, angles_deg: Sequence[float]) -> None:
    """Has `parted_pit` know all these angles by one solve for each support."""
    for support, solid in forward.base.solids.items():
        known = _known(forward, support)
        wanted = [angle for angle in map(_rounded, angles_deg) if angle not in known]
        if wanted:
            known.update(zip(wanted, PartedPit.each(solid, wanted), strict=True))


def _known(forward: ForwardModel, support: Support) -> dict[float, PartedPit]:
    """The angles that have been solved for."""
    return forward.memoised(("parted pits", support), dict[float, PartedPit])


def _rounded(angle_deg: float) -> float:
    return round(angle_deg % 180.0, 2) % 180.0


def parted_response(
    forward: ForwardModel, recording: GraspResponse, angle_deg: float
) -> Float[np.ndarray, "f n 3"]:
    """What two free halves (m = 1) add to c(t), mm MPa."""
    modes = parted_pit(forward, recording, angle_deg).at_markers(recording)
    return recording.over_time(_by_work(modes, recording.patterns))


@dataclass(frozen=True)
class OfHalves:
    """How s W S^-1 W' f follows from forces (fem.mismatch.model.force_products)."""

    forward: ForwardModel
    angle_deg: float

    def product(self, noise: ForceNoise) -> float:
        """By the work that both do on the modes: no solve."""
        modes = self._modes(noise)
        moved, pulled = (
            np.einsum("qnx,prnx->pqr", modes, force_N, optimize=True)
            for force_N in (noise.force_N, noise.pulled)
        )
        return noise.compliance * noise.of_draws(np.einsum("pqr,pqr->p", moved, pulled))

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """Without a solve."""
        modes = self._modes(noise)
        return noise.over_time(np.stack([_by_work(modes, force_N) for force_N in noise.force_N]))

    def _modes(self, noise: ForceNoise) -> Float[np.ndarray, "6 n 3"]:
        return parted_pit(self.forward, noise.recording, self.angle_deg).at_markers(noise.recording)


def _by_work(
    modes: Float[np.ndarray, "6 n 3"], force_N: Float[np.ndarray, "r n 3"]
) -> Float[np.ndarray, "r n 3"]:
    work = np.tensordot(force_N, modes, axes=([1, 2], [1, 2]))
    return np.asarray(np.tensordot(work, modes, axes=1))


def _forces(solid: UnitModulusSolid, moved: Float[np.ndarray, "f m 3"]) -> Float[np.ndarray, "f m 3"]:
    """K0 u."""
    flat = solid.stiffness @ moved.reshape(len(moved), -1).T
    return np.ascontiguousarray(flat.T).reshape(moved.shape)

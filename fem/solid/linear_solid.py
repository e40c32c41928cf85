"""Displacement of the flesh under loads for E = 1 MPa; divide by E in MPa for the real one."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from fem.cached_value import cached_value
from fem.elements.assembly import Stiffness, assemble, lumped_moments
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.flesh_mesh import FleshMesh
from fem.solid.rigid_core import pit_centre_mm, reduced, reduction, rigid_modes
from fem.sparse.solver import Factor, factorise

Support = Literal["free", "base"]
#: skin nodes at most this high above the lowest point are held by a base
BASE_HEIGHT_MM = 0.2


@dataclass(frozen=True)
class FreeBody:
    """Rigid motions R (3 n, 6) about the flesh's centroid, and M R, body forces of rigid accelerations.

    M is the mass matrix for unit density. With P = I - R (R' M R)^-1 R' M, a load f is balanced by P' f
    (the body forces of a rigid acceleration), and P u is u without its mean rigid motion. Both together
    make the compliance P K^- P' symmetric and independent of how the rigid motion was held.
    """

    modes: Float[np.ndarray, "d 6"]
    body_forces: Float[np.ndarray, "d 6"]
    inertia: Float[np.ndarray, "6 6"]

    @classmethod
    def of(cls, mesh: FleshMesh) -> "FreeBody":
        """The rigid motions of the flesh of a mesh (the pit has no mass)."""
        moments = lumped_moments(mesh.nodes_mm, mesh.tets)
        centre_mm = moments[:, 1:].sum(axis=0) / moments[:, 0].sum()
        modes = rigid_modes(mesh.nodes_mm, centre_mm=centre_mm).reshape(-1, 6)
        # M (w x (x - c)) at a node is w x (integral of N x - c integral of N)
        forces = rigid_modes(moments[:, 1:] - moments[:, :1] * centre_mm, centre_mm=np.zeros(3))
        forces[:, :, :3] *= moments[:, :1, None]
        body_forces = forces.reshape(-1, 6)
        return cls(modes, body_forces, modes.T @ body_forces)

    def acceleration(self, load_N: Float[np.ndarray, "d f"]) -> Float[np.ndarray, "6 f"]:
        """(R' M R)^-1 R' f: amounts of the body forces that balance each load."""
        return np.asarray(np.linalg.solve(self.inertia, self.modes.T @ load_N))


@dataclass(frozen=True, kw_only=True)
class UnitModulusSolid:
    """Flesh of E = 1 MPa around a rigid, bonded, freely moving pit; factorised once, solved for many loads.

    support "free": nothing holds the fruit. A smooth body force, linear over the flesh (as inertia would be),
    first balances any load. Of the displacements that differ by a rigid motion, the result is the one whose
    mean translation and rotation over the flesh vanish. The compliance stays symmetric.
    support "base": skin nodes within 0.2 mm of the lowest z do not move.
    `under_body_forces`: displacement of the held flesh under each of the free body's forces; none on a base;
    solved for at once, so that copies of the solid for other contact nodes share it.
    `contact_nodes`: skin nodes of `contact_compliance`.
    """

    mesh: FleshMesh
    poisson_ratio: float
    support: Support
    parts: Stiffness
    stiffness: csr_array
    kinematics: csr_array
    factor: Factor
    free_body: FreeBody
    under_body_forces: Float[np.ndarray, "d _"]
    contact_nodes: Int[np.ndarray, " c"]

    @classmethod
    def factorise(
        cls,
        mesh: FleshMesh,
        *,
        poisson_ratio: float,
        support: Support,
        parts: Stiffness | None = None,
        contact_nodes: Int[np.ndarray, " c"] | None = None,
    ) -> "UnitModulusSolid":
        """Assemble K0(nu), tie the pit's nodes to its six motions, fix the support's dofs, factorise.

        `parts`, from fem.elements.assembly.assemble(mesh.nodes_mm, mesh.tets), spares the assembly for
        another nu.
        Raises FemFailure: BAD_POISSON_RATIO, NO_BASE, SINGULAR_STIFFNESS.
        """
        parts = assemble(mesh.nodes_mm, mesh.tets) if parts is None else parts
        stiffness = parts.for_unit_modulus(poisson_ratio=poisson_ratio)
        motions = reduction(mesh.nodes_mm, mesh.pit_nodes)
        moving = _moving(mesh, motions.shape[1], support)
        kinematics = csr_array(motions[:, np.flatnonzero(moving)])
        nodes = np.zeros(0, dtype=np.int64) if contact_nodes is None else contact_nodes
        factor = factorise(reduced(stiffness, kinematics))
        free_body = FreeBody.of(mesh)
        under_body_forces = np.zeros((3 * len(mesh.nodes_mm), 0))
        if support == "free":
            under_body_forces = kinematics @ factor.solve(kinematics.T @ free_body.body_forces)
        return cls(
            mesh=mesh,
            poisson_ratio=poisson_ratio,
            support=support,
            parts=parts,
            stiffness=stiffness,
            kinematics=kinematics,
            factor=factor,
            free_body=free_body,
            under_body_forces=under_body_forces,
            contact_nodes=nodes,
        )

    def displacement(self, nodal_force_N: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """Nodal displacements times E, mm MPa, for each of f loads given as forces on the nodes, N.

        Forces on pit nodes act on the pit as a whole. Raises BAD_LOAD: wrong shape or non-finite numbers.
        """
        load = self._columns(nodal_force_N)
        displacement = self.kinematics @ self.factor.solve(self.kinematics.T @ load)
        if self.support == "free":
            displacement -= self._of_balance(load, self.free_body.body_forces.T @ displacement, slice(None))
        return np.ascontiguousarray(displacement.T).reshape(nodal_force_N.shape)

    def contact_displacement(self, nodal_force_N: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f c 3"]:
        """`displacement` of the contact nodes alone, without that of the rest. Raises BAD_LOAD."""
        load = self._columns(nodal_force_N)
        dofs, moves, columns = self._contact_dofs
        displacement = np.zeros((len(dofs), load.shape[1]))
        displacement[moves] = self.factor.solve_at(self.kinematics.T @ load, columns)
        if self.support == "free":
            displacement -= self._of_balance(load, self.under_body_forces.T @ load, dofs)
        return np.ascontiguousarray(displacement.T).reshape(len(nodal_force_N), -1, 3)

    def _of_balance(
        self,
        load: Float[np.ndarray, "d f"],
        work: Float[np.ndarray, "6 f"],
        dofs: Int[np.ndarray, " c"] | slice,
    ) -> Float[np.ndarray, "c f"]:
        """Displacement of these dofs by the forces that balance a free fruit, and the mean rigid motion.

        `work`: of the body forces on the displacement by the loads alone.
        """
        body, acceleration = self.free_body, self.free_body.acceleration(load)
        left = work - (body.body_forces.T @ self.under_body_forces) @ acceleration
        motion = np.linalg.solve(body.inertia, left)
        return np.asarray(self.under_body_forces[dofs] @ acceleration + body.modes[dofs] @ motion)

    @cached_value
    def _contact_dofs(self) -> tuple[Int[np.ndarray, " d"], Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
        """The contact nodes' dofs on all nodes; which of them move, and which of K's dofs those are."""
        dofs = (3 * self.contact_nodes[:, None] + np.arange(3)).ravel()
        rows = self.kinematics[dofs]
        return dofs, np.flatnonzero(np.diff(rows.indptr)), rows.indices

    @cached_value
    def contact_compliance(self) -> Float[np.ndarray, "d d"]:
        """Displacement times E of the contact nodes' dofs (three a node, in order) under unit forces on them.

        mm MPa / N; symmetric; what `displacement` gives, without a solve for each. A free fruit's is P A P'
        with P of `FreeBody` and A the compliance of the fruit held at its pit (or three nodes);
        zero where a base holds.
        """
        dofs, moves, columns = self._contact_dofs
        held = self.factor.compliance(columns)
        if len(moves) < len(dofs):
            moving, held = held, np.zeros((len(dofs), len(dofs)))
            held[np.ix_(moves, moves)] = moving
        if self.support == "base":
            return held
        body, displacement = self.free_body, self.under_body_forces
        rigid = body.modes[dofs] @ np.linalg.inv(body.inertia)
        mean = 0.5 * rigid @ (body.body_forces.T @ displacement)
        across = (mean - displacement[dofs]) @ rigid.T
        held += across
        held += across.T
        return held

    def pit_motion(self, displacement: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f 6"]:
        """Translation (mm MPa) and rotation (rad MPa) of the pit about the mean of its nodes."""
        nodes = self.mesh.pit_nodes
        if not len(nodes):
            return np.zeros((len(displacement), 6))
        centre_mm = pit_centre_mm(self.mesh.nodes_mm, nodes)
        modes = rigid_modes(self.mesh.nodes_mm[nodes], centre_mm=centre_mm).reshape(-1, 6)
        pit_motion = displacement[:, nodes].reshape(len(displacement), -1)
        return np.asarray(np.linalg.lstsq(modes, pit_motion.T, rcond=None)[0].T)

    def _columns(self, nodal_force_N: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "d f"]:
        """The loads as columns (3 n, loads). Raises FemFailure (BAD_LOAD)."""
        n = len(self.mesh.nodes_mm)
        if (
            nodal_force_N.ndim != 3
            or nodal_force_N.shape[1:] != (n, 3)
            or not np.isfinite(nodal_force_N).all()
        ):
            raise FemFailure(
                FemProblem.BAD_LOAD,
                f"loads have the shape {nodal_force_N.shape} or contain non-finite numbers, expected "
                f"(loads, {n}, 3) finite forces in N",
            )
        return nodal_force_N.reshape(len(nodal_force_N), 3 * n).T


def _moving(mesh: FleshMesh, n_motions: int, support: Support) -> Bool[np.ndarray, " d"]:
    """Columns of T that may move: a free fruit is held at its pit (or three nodes), another at its base."""
    n_free_dofs = 3 * (len(mesh.nodes_mm) - len(mesh.pit_nodes))
    moving = np.ones(n_motions, dtype=bool)
    if support == "base":
        moving[_dofs(mesh, _base_nodes(mesh))] = False
    elif len(mesh.pit_nodes):
        moving[n_free_dofs:] = False
    else:
        moving[_three_two_one(mesh)] = False
    return moving


def _dofs(mesh: FleshMesh, nodes: np.ndarray) -> np.ndarray:
    """Columns of T that are the displacements of these (free) nodes."""
    before = nodes - np.searchsorted(mesh.pit_nodes, nodes)
    return (3 * before[:, None] + np.arange(3)).ravel()


def _base_nodes(mesh: FleshMesh) -> np.ndarray:
    """Skin nodes on the base; raises NO_BASE where they do not span an area."""
    skin = mesh.outer_nodes
    height = mesh.nodes_mm[skin, 2]
    held = skin[height <= height.min() + BASE_HEIGHT_MM]
    spread = np.linalg.svd(mesh.nodes_mm[held] - mesh.nodes_mm[held].mean(axis=0), compute_uv=False)
    if len(held) < 3 or spread[1] < 0.1:
        raise FemFailure(
            FemProblem.NO_BASE,
            f"only {len(held)} skin nodes lie within {BASE_HEIGHT_MM} mm of the lowest point, too few "
            "to support the fruit. Use a finer mesh at the base (refine_at_mm) or the support 'free'",
        )
    return np.asarray(held)


def _three_two_one(mesh: FleshMesh) -> np.ndarray:
    """Six dofs of three far-apart skin nodes that hold a fruit without a pit, one rigid motion each."""
    skin = mesh.outer_nodes
    x = mesh.nodes_mm[skin]
    a = int(np.linalg.norm(x - x.mean(axis=0), axis=1).argmax())
    b = int(np.linalg.norm(x - x[a], axis=1).argmax())
    axis = (x[b] - x[a]) / np.linalg.norm(x[b] - x[a])
    away = np.linalg.norm(np.cross(x - x[a], axis), axis=1)
    c = int(away.argmax())
    normal = np.cross(axis, x[c] - x[a])
    across = np.delete(np.arange(3), np.abs(axis).argmax())
    out = np.abs(normal).argmax()
    return np.concatenate(
        [_dofs(mesh, skin[[a]]), _dofs(mesh, skin[[b]])[across], _dofs(mesh, skin[[c]])[[out]]]
    )

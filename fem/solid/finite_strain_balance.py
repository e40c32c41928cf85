"""Residual and tangent of a fruit at finite strain, in the unknowns that its pit and its support allow.

Unknowns: the loose nodes' displacements; six border motions (those of the pit, or of three nodes that hold a
fruit without one); for a free fruit six multipliers of the mean rigid motion. Only the loose block is
factorised, always with one sparsity pattern; border and multipliers are dense and few. The pit may rotate by
any angle, x = c + t + R a for a = X - c at rest.

    [ K   W ] [ x ]   [ a ]         (S - W' K^-1 W) y = b - W' K^-1 a,   x = K^-1 (a - W y)
    [ W'  S ] [ y ] = [ b ]
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from fem.cached_value import cached_value
from fem.solid.finite_strain_elements import FiniteFlesh
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.rigid_core import pit_centre_mm, rigid_modes
from fem.sparse.solver import Analysis, Factor, analyse


@dataclass(frozen=True)
class FiniteState:
    """Displacements of all nodes, shift and rotation of the pit, the multipliers, the flesh's own forces."""

    displacement_mm: Float[np.ndarray, "n 3"]
    shift_mm: Float[np.ndarray, "3"]
    turn: Float[np.ndarray, "3 3"]
    multipliers: Float[np.ndarray, " c"]
    force_N: Float[np.ndarray, "n 3"] = field(repr=False)


@dataclass(frozen=True)
class BorderedTangent:
    """The factor of the loose block with its border; without one, the factor alone."""

    factor: Factor
    border: Float[np.ndarray, "k b"]
    swept: Float[np.ndarray, "k b"]
    schur: Float[np.ndarray, "b b"]

    @classmethod
    def of(
        cls, factor: Factor, border: Float[np.ndarray, "k b"], corner: Float[np.ndarray, "b b"]
    ) -> "BorderedTangent":
        """One solve for each column of the border."""
        swept = factor.solve(border) if border.shape[1] else border
        return cls(factor, border, swept, corner - border.T @ swept)

    def solve(self, residual: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """The step that solves the linear problem K step = + residual.

        Several residuals are the columns of one array: solving them together costs little more than one.
        """
        k = len(self.border)
        loose = self.factor.solve(residual[:k].reshape(k, -1)).reshape(residual[:k].shape)
        if not self.border.shape[1]:
            return loose
        rest = np.linalg.solve(self.schur, residual[k:] - self.border.T @ loose)
        return np.concatenate([loose - self.swept @ rest, rest])


@dataclass(frozen=True, kw_only=True)
class FiniteBalance:
    """The flesh under one load at finite strain, for `fem.solid.equilibrium`.

    `analyses`: that of the loose block, made at the first tangent and reused for all later ones.
    """

    solid: UnitModulusSolid
    flesh: FiniteFlesh
    load: Float[np.ndarray, "n 3"]
    load_size: float
    loose: Int[np.ndarray, " k"]
    held: Int[np.ndarray, " h"]
    arm_mm: Float[np.ndarray, "p 3"]
    means: Float[np.ndarray, "d c"]
    analyses: list[Analysis] = field(default_factory=list)

    @classmethod
    def of(cls, solid: UnitModulusSolid, flesh: FiniteFlesh) -> "FiniteBalance":
        """Without load."""
        mesh, free = solid.mesh, solid.support == "free"
        is_pit = np.zeros(len(mesh.nodes_mm), dtype=bool)
        is_pit[mesh.pit_nodes] = True
        stays = np.diff(solid.kinematics.indptr) == 0
        loose = np.flatnonzero(~stays & ~np.repeat(is_pit, 3))
        held = np.flatnonzero(stays & ~np.repeat(is_pit, 3)) if free else np.zeros(0, dtype=np.int64)
        centre = pit_centre_mm(mesh.nodes_mm, mesh.pit_nodes) if is_pit.any() else np.zeros(3)
        # mean motions in mm (rotations at the size of the fruit), times a stiffness: the columns of B
        length = mesh.volume_mm3 ** (1 / 3)
        scale = length * np.array([1.0, 1.0, 1.0, length, length, length])
        body = solid.free_body
        means = np.zeros((is_pit.size * 3, 0))
        if free:
            means = np.linalg.solve(body.inertia, body.body_forces.T).T * scale
        return cls(
            solid=solid,
            flesh=flesh,
            load=np.zeros(mesh.nodes_mm.shape),
            load_size=1.0,
            loose=loose,
            held=held,
            arm_mm=mesh.nodes_mm[mesh.pit_nodes] - centre,
            means=means,
        )

    def under(self, load: Float[np.ndarray, "n 3"]) -> "FiniteBalance":
        """The same under dead forces on the nodes; those on pit nodes act on the pit."""
        at_rest = self._reduced(load, self.arm_mm)
        return replace(self, load=load, load_size=max(float(np.linalg.norm(at_rest)), 1e-300))

    @property
    def primal(self) -> int:
        """Loose dofs and border motions."""
        return len(self.loose) + self._n_border

    @property
    def _n_border(self) -> int:
        return 6 if len(self.arm_mm) else len(self.held)

    def state(self, displacement_mm: Float[np.ndarray, "n 3"]) -> FiniteState:
        """The state nearest to a displacement: the pit's nodes move rigidly, the support's do not move."""
        admissible_mm = np.zeros_like(displacement_mm)
        kept = np.concatenate([self.loose, self.held])
        admissible_mm.ravel()[kept] = displacement_mm.ravel()[kept]
        shift, turn = np.zeros(3), np.eye(3)
        if len(self.arm_mm):
            shift, turn = rigid_fit(self.arm_mm, displacement_mm[self.solid.mesh.pit_nodes])
        return self._state(admissible_mm, shift, turn, np.zeros(self.means.shape[1]))

    def admissible(self, displacement_mm: Float[np.ndarray, "n 3"]) -> FiniteState:
        """`state` of the displacement, or of a part of it if the whole would invert elements."""
        share = 1.0
        while True:
            state = self.state(share * displacement_mm)
            if np.isfinite(state.force_N).all():
                return state
            share = share / 2 if share > 1e-3 else 0.0

    def residual(self, state: FiniteState) -> Float[np.ndarray, " d"]:
        """Forces of the flesh and of the multipliers less the load, then the mean rigid motion."""
        nodal = state.force_N - self.load
        nodal = nodal + (self.means @ state.multipliers).reshape(nodal.shape)
        mean = self.means.T @ state.displacement_mm.ravel()
        return np.concatenate([self._reduced(nodal, self.arm_mm @ state.turn.T), mean])

    def size(self, residual: Float[np.ndarray, " d"]) -> float:
        """The 2-norm, as a share of the load's."""
        return float(np.linalg.norm(residual)) / self.load_size

    def moved(self, state: FiniteState, step: Float[np.ndarray, " d"], share: float) -> FiniteState:
        """Rotation steps of the pit are composed; multipliers are always added in full."""
        multipliers = state.multipliers + step[self.primal :]
        if share == 0:
            return replace(state, multipliers=multipliers)
        admissible_mm = state.displacement_mm.copy()
        admissible_mm.ravel()[self.loose] += share * step[: len(self.loose)]
        border = share * step[len(self.loose) : self.primal]
        shift, turn = state.shift_mm, state.turn
        if len(self.arm_mm):
            shift, turn = shift + border[:3], turned(turn, border[3:])
        else:
            admissible_mm.ravel()[self.held] += border
        return self._state(admissible_mm, shift, turn, multipliers)

    def tangent(self, state: FiniteState) -> BorderedTangent:
        """Assembled and factorised; the order of elimination is found once."""
        stiffness = self.flesh.stiffness(state.displacement_mm)
        rows = stiffness[self.loose]
        loose: csr_array = rows[:, self.loose]
        if not self.analyses:
            self.analyses.append(analyse(loose))
        factor = self.analyses[0].factorise(loose)
        motions = self._border_motions(self.arm_mm @ state.turn.T)
        border, corner = self._border(stiffness, motions)
        if len(self.arm_mm):
            nodal = state.force_N - self.load + (self.means @ state.multipliers).reshape(self.load.shape)
            turning = turning_stiffness(self.arm_mm @ state.turn.T, nodal[self.solid.mesh.pit_nodes])
            corner[3:6, 3:6] += turning
        return BorderedTangent.of(factor, border, corner)

    @cached_value
    def linear_tangent(self) -> BorderedTangent:
        """With the solid's own factor, which includes the pit's motions on a base, not in a free fruit.

        Threads use that of `FiniteStrainSolid.rest`, which is prepared beforehand.
        """
        motions = self._border_motions(self.arm_mm)
        if self.solid.kinematics.shape[1] == self.primal:
            return BorderedTangent.of(self.solid.factor, np.zeros((self.primal, 0)), np.zeros((0, 0)))
        return BorderedTangent.of(self.solid.factor, *self._border(self.solid.stiffness, motions))

    def _border(
        self, stiffness: csr_array, motions: csr_array
    ) -> tuple[Float[np.ndarray, "k b"], Float[np.ndarray, "b b"]]:
        """W and S: coupling of border motions and multipliers with the loose dofs and with each other."""
        n_border, n = motions.shape[1], motions.shape[1] + self.means.shape[1]
        pulled = (stiffness @ motions).toarray()
        border = np.hstack([pulled[self.loose], self.means[self.loose]])
        corner = np.zeros((n, n))
        corner[:n_border, :n_border] = motions.T @ pulled
        corner[:n_border, n_border:] = motions.T @ self.means
        corner[n_border:, :n_border] = corner[:n_border, n_border:].T
        return border, corner

    def _border_motions(self, arm_mm: Float[np.ndarray, "p 3"]) -> csr_array:
        """Nodal displacements (3 n, b) of each border motion, the pit at its present place."""
        n = self.load.size
        dofs, values = self.held, np.eye(len(self.held))
        if len(arm_mm):
            dofs = (3 * self.solid.mesh.pit_nodes[:, None] + np.arange(3)).ravel()
            values = rigid_modes(arm_mm, centre_mm=np.zeros(3)).reshape(-1, 6)
        row = np.repeat(dofs, values.shape[1])
        column = np.tile(np.arange(values.shape[1]), len(dofs))
        return csr_array((values.ravel(), (row, column)), shape=(n, values.shape[1]))

    def _reduced(
        self, nodal: Float[np.ndarray, "n 3"], arm_mm: Float[np.ndarray, "p 3"]
    ) -> Float[np.ndarray, " d"]:
        """Generalised forces on the loose dofs and the border motions."""
        flat = nodal.ravel()
        on_border = resultant(arm_mm, nodal[self.solid.mesh.pit_nodes]) if len(arm_mm) else flat[self.held]
        return np.concatenate([flat[self.loose], on_border])

    def _state(
        self,
        displacement_mm: Float[np.ndarray, "n 3"],
        shift_mm: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "3 3"],
        multipliers: Float[np.ndarray, " c"],
    ) -> FiniteState:
        if len(self.arm_mm):
            displacement_mm[self.solid.mesh.pit_nodes] = shift_mm + self.arm_mm @ (turn - np.eye(3)).T
        return FiniteState(displacement_mm, shift_mm, turn, multipliers, self.flesh.force_N(displacement_mm))


def turned(turn: Float[np.ndarray, "3 3"], step_rad: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """exp(step) R: the rotation R followed by a further one, a rotation vector in space.

    A quarter turn about z takes x to y.

    >>> (turned(np.eye(3), np.array([0, 0, np.pi / 2])) @ [1.0, 0, 0]).round(6)
    array([0., 1., 0.])
    """
    return np.asarray(Rotation.from_rotvec(step_rad).as_matrix() @ turn)


def rigid_fit(
    arm_mm: Float[np.ndarray, "p 3"], displacement_mm: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Shift t and rotation R of the rigid motion nearest to the displacements of a body's points.

    Least squares of |a + u - t - R a|. Source: Kabsch, Acta Crystallographica A 32, 1976.
    """
    mean_arm, mean_displacement = arm_mm.mean(axis=0), displacement_mm.mean(axis=0)
    turn, _ = Rotation.align_vectors(
        arm_mm + displacement_mm - mean_arm - mean_displacement, arm_mm - mean_arm
    )
    matrix = turn.as_matrix()
    return mean_displacement + mean_arm - matrix @ mean_arm, matrix


def resultant(arm_mm: Float[np.ndarray, "p 3"], force_N: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "6"]:
    """Total force (N) and moment (N mm) of forces at the ends of these arms.

    A couple: no force, and a moment of 20 N mm about z.

    >>> resultant(np.array([[10.0, 0, 0], [-10, 0, 0]]), np.array([[0, 1.0, 0], [0, -1, 0]]))
    array([ 0.,  0.,  0.,  0.,  0., 20.])
    """
    return np.concatenate([force_N.sum(axis=0), np.cross(arm_mm, force_N).sum(axis=0)])


def turning_stiffness(
    arm_mm: Float[np.ndarray, "p 3"], force_N: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "3 3"]:
    """Contribution of forces f of fixed direction to the stiffness against rotation (N mm per rad).

    The moment a x f of a force at the end of a changes by (w x a) x f = (a f' - (a . f) I) w; a is the arm in
    its present place and f the force that holds the point. Symmetric where the moments cancel.
    """
    product = arm_mm.T @ force_N
    return np.asarray(product - np.trace(product) * np.eye(3))

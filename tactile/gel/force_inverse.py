"""From the displacement of a gel's face to the forces on it: a linear inverse, its prior chosen by the data.

Unknowns are forces t on the nodes of a square grid (tents of traction, `gel_slab`). Marker displacements y
with information W (inverse covariance; zero along what a camera cannot see) and a Gaussian prior of precision
Q = (1 + roughness^2 Laplacian) / sd^2 on each component give

    L t = G' W y,    L = G' W G + Q,    covariance of t = L^-1

on the nodes in contact; t = 0 outside, and pressure is positive inside (an active set, from the unbound
solution, with nodes dropped that would pull and neighbours added that want to push). G' W and L are made once
per sensor. G is continued by smooth fields that no force makes (quadratics over the pad, a percent or two of
the displacement): what free sides and a housing do to a slab that is not endless. They matter: an almost
incompressible gel is so stiff against even pressure that 5 um of even depth are 5 % of a press of 3 N. The
prior's spread and roughness, and by how much the noise exceeds what frames in the air show, are those of
greatest marginal likelihood

    2 log p = t' L t - y' W y - log det L + log det Q + log det W      (constants left out; MacKay 1992).

Because t is linear in y, force and displacement share their noise: `GelForce.joint_covariance` has both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_factor, cho_solve, cholesky, lapack

from tactile.gel.grid import GelGrid, with_smooth

TOUCHES_AT_SD, STARTS_AT = 4.0, 0.3
"""A node is in contact at first where it is pushed by so many standard deviations, or by such a share of the
most. Set by hand."""
GROWS_AT_SD = 1.0
"""A node beside the contact joins it where it would be pushed by so many standard deviations."""
APPEARS_AT_SD = 6.0
"""A node away from it needs more: among hundreds of nodes 4 would come by chance now and then. Set by
hand."""
MOST_ROUNDS = 12
"""In which nodes may join; then they only leave, so that the search ends. Set by hand."""
SMOOTH_SHARE = np.array([0.02, 0.02, 0.005])
"""Spread of a smooth field's coefficients over the largest displacement of the frame, x, y and z; free sides
three thicknesses away make 0.03 and 0.007 (`benchmarks/gel_image_errors.py`)."""
LEAST_MOTION_MM, USUAL_MOTION_MM = 0.1, 0.5
"""Largest displacement of a frame, mm: at least this for the smooth field, and that of a usual press."""
ORDER_OF_CLIMBING = ("pressure_MPa", "shear_MPa", "noise", "roughness", "pressure_MPa", "shear_MPa", "noise")


@dataclass(frozen=True, kw_only=True)
class PriorHyperparameters:
    """The prior: spread of pressure and of shear (MPa), roughness (pitches); noise over that in the air."""

    pressure_MPa: float
    shear_MPa: float
    roughness: float
    noise: float


INITIAL_HYPERPARAMETERS = PriorHyperparameters(pressure_MPa=0.03, shear_MPa=0.01, roughness=1.0, noise=2.0)
"""Where the search for the prior starts: a usual press, node by node as noisy as twice what frames say. Set
by hand."""


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Which nodes touch, the unknowns (0 outside), and each outer node's push in standard deviations."""

    touching: Bool[np.ndarray, " m"]
    unknowns: Float[np.ndarray, " u"]
    push_sd: Float[np.ndarray, " m"]


@dataclass(frozen=True, kw_only=True)
class GelContact:
    """One frame solved: nodal forces (N) on the fruit, which nodes touch, and what the slab shows for it.

    `motion_mm` is the largest displacement, by which the smooth fields are scaled.
    """

    node_force_N: Float[np.ndarray, "m 3"]
    touching: Bool[np.ndarray, " m"]
    motion_mm: float
    force_N: Float[np.ndarray, "n 3"]
    displacement_mm: Float[np.ndarray, "n 3"]


class InvertedForce:
    """The inverse of one gel, ready for frames: everything that frames share is computed here.

    `information_per_mm2` (n, 3, 3) is the inverse covariance of one frame's marker displacement as frames in
    the air show it; `observed`: the sensor's response to nodal forces and smooth fields, if it is not
    displacement.
    """

    def __init__(
        self,
        grid: GelGrid,
        information_per_mm2: Float[np.ndarray, "n 3 3"],
        hyperparameters: PriorHyperparameters,
        *,
        observed: Float[np.ndarray, "3*n u"] | None = None,
    ) -> None:
        self.grid, self.hyperparameters = grid, hyperparameters
        self.information = information_per_mm2 / hyperparameters.noise**2
        self._observed_by = _moved(grid) if observed is None else observed
        self._moved_by = _moved(grid)
        per_marker = self._observed_by.reshape(len(grid.rest_mm), 3, -1)
        self._weighted = np.matmul(self.information, per_marker).reshape(self._observed_by.shape)
        self._data = self._weighted.T @ self._observed_by
        self._normal = self._data.copy()
        size = 3 * len(grid.nodes_mm)
        self._normal[:size, :size] += _prior(grid, hyperparameters)
        self._size = size
        loose = self._normal.copy()
        loose[size:, size:] += np.diag(_smooth_precision(USUAL_MOTION_MM))
        self._free = _factored(loose)

    def solve(
        self, displacement_mm: Float[np.ndarray, "n 3"], seen: Bool[np.ndarray, " n"] | None = None
    ) -> GelContact:
        """One frame; markers that are not `seen` (or NaN) are left out."""
        y, normal, right = self._observed(displacement_mm, seen)
        motion_mm = _motion(y)
        found = self._solved_active_set(normal, right, motion_mm)
        t = found.unknowns[: self._size].reshape(-1, 3)
        return GelContact(
            node_force_N=t,
            touching=found.touching,
            motion_mm=motion_mm,
            force_N=self.grid.to_markers @ t,
            displacement_mm=(self._moved_by @ found.unknowns).reshape(y.shape),
        )

    def active_set(
        self, displacement_mm: Float[np.ndarray, "n 3"], seen: Bool[np.ndarray, " n"] | None = None
    ) -> ActiveSet:
        """The active set of one frame: no touching node pulls, none outside pushes by six times the noise."""
        y, normal, right = self._observed(displacement_mm, seen)
        return self._solved_active_set(normal, right, _motion(y))

    def _block(
        self, touching: Bool[np.ndarray, " m"], motion_mm: float, normal: np.ndarray | None = None
    ) -> Float[np.ndarray, "a a"]:
        """The normal matrix of the unknowns in play, the smooth fields held in proportion to the motion."""
        at = self._at(touching)
        block = (self._normal if normal is None else normal)[np.ix_(at, at)]
        end = np.arange(len(at) - (len(self._normal) - self._size), len(at))
        block[end, end] += _smooth_precision(motion_mm)
        return np.asarray(block)

    def _at(self, touching: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " a"]:
        """Unknowns in play: the touching nodes' forces and the smooth fields."""
        smooth = np.arange(3 * len(touching), len(self._normal))
        return np.concatenate([_dofs(touching), smooth])

    def joint_covariance(
        self, touching: Bool[np.ndarray, " m"], motion_mm: float
    ) -> Float[np.ndarray, "d d"]:
        """Covariance of one frame's [measured displacement (mm); marker force (N)], markers then x, y, z.

        Measured y = G t + noise and the force's estimate K y share the noise e: displacement I e and force
        K e, so that the blocks are S, S K' and K S K' plus what the prior leaves open; S is the noise's
        covariance (a pseudo-inverse where a camera sees no depth).
        """
        n = len(self.grid.rest_mm)
        noise = np.zeros((3 * n, 3 * n))
        block = (
            (3 * np.arange(n)[:, None] + np.arange(3))[:, :, None],
            (3 * np.arange(n)[:, None] + np.arange(3))[:, None, :],
        )
        noise[block] = np.linalg.pinv(self.information, hermitian=True, rcond=1e-9)
        linear = self.linear_map(touching, motion_mm)
        at = self._at(touching)
        spread = self._to_markers(touching, len(at))
        posterior = spread @ cho_solve(cho_factor(self._block(touching, motion_mm)), spread.T)
        cross = noise @ linear.T
        return np.block([[noise, cross], [cross.T, posterior]])

    def linear_map(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "d d"]:
        """K in force = K displacement, N/mm, while these nodes touch."""
        at = self._at(touching)
        inner = cho_solve(cho_factor(self._block(touching, motion_mm)), self._weighted[:, at].T)
        return np.asarray(self._to_markers(touching, len(at)) @ inner)

    def _to_markers(self, touching: Bool[np.ndarray, " m"], unknowns: int) -> Float[np.ndarray, "d a"]:
        forces = np.kron(self.grid.to_markers[:, touching], np.eye(3))
        return np.pad(forces, ((0, 0), (0, unknowns - forces.shape[1])))

    def force_spread(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "n 3"]:
        """Standard deviation that the frame's noise and the prior leave in marker force, N."""
        if not touching.any():
            return np.zeros(self.grid.rest_mm.shape)
        root = self._root(touching, motion_mm)
        nodal = root[:, : 3 * int(touching.sum())].reshape(len(root), -1, 3)
        force = np.tensordot(nodal, self.grid.to_markers[:, touching], axes=(1, 1))
        return np.asarray(np.sqrt((force**2).sum(axis=0)).T)

    def slab_spread(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "n 3"]:
        """The same of the displacement that the forces make, mm."""
        moved = self._root(touching, motion_mm) @ self._moved_by[:, self._at(touching)].T
        return np.asarray(np.sqrt((moved**2).sum(axis=0)).reshape(self.grid.rest_mm.shape))

    def _root(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "a a"]:
        """A root of the covariance of the unknowns in play: R' R."""
        factor = cholesky(self._block(touching, motion_mm), lower=True, check_finite=False)
        return np.asarray(np.tril(lapack.dtrtri(factor, lower=1)[0]))

    def _observed(
        self, displacement_mm: np.ndarray, seen: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacement (0 where unknown), normal matrix and right side of the markers that are known."""
        usable = np.isfinite(displacement_mm).all(axis=1)
        if seen is not None:
            usable &= seen
        y = np.where(usable[:, None], displacement_mm, 0.0)
        normal = self._normal
        if not usable.all():
            lost = (3 * np.flatnonzero(~usable)[:, None] + np.arange(3)).ravel()
            normal = normal - self._weighted[lost].T @ self._observed_by[lost]
        return y, normal, self._weighted.T @ y.ravel()

    def _solved_active_set(self, normal: np.ndarray, right: np.ndarray, motion_mm: float) -> ActiveSet:
        """The active set; after `MOST_ROUNDS` nodes only leave, so that it ends with none that pulls."""
        m = len(self.grid.nodes_mm)
        normal_rows = slice(2, 3 * m, 3)
        factor, sd = self._free
        if normal is not self._normal:
            loose = normal.copy()
            loose[self._size :, self._size :] += np.diag(_smooth_precision(USUAL_MOTION_MM))
            factor, sd = _factored(loose)
        free = cho_solve(factor, right, check_finite=False)[normal_rows]
        adjacent = self.grid.laplacian < 0
        push_information = self._push_information(normal)
        single_node_sd = self._single_node_sd(normal, right, motion_mm, push_information)
        # sure where depth is seen; where it is not, every node is unsure and a good part of the peak must do
        sure = np.minimum(TOUCHES_AT_SD * sd[normal_rows], STARTS_AT * free.max())
        touching = (free > sure) & (single_node_sd > APPEARS_AT_SD)
        touching[np.argmax(single_node_sd)] |= single_node_sd.max() > APPEARS_AT_SD
        dropped = np.zeros_like(touching)
        for turn in count():
            at = self._at(touching)
            block = self._block(touching, motion_mm, normal)
            factor = cho_factor(block, lower=True, overwrite_a=True, check_finite=False)
            found = cho_solve(factor, right[at], check_finite=False)
            push = (right[normal_rows] - normal[normal_rows][:, at] @ found) / np.sqrt(push_information)
            pulls = np.flatnonzero(touching)[found[2 : 3 * int(touching.sum()) : 3] < 0]
            near = (adjacent @ touching.astype(float)) > 0
            joins = ~touching & ((near & ~dropped & (push > GROWS_AT_SD)) | (push > APPEARS_AT_SD))
            joins &= touching.any() & (turn < MOST_ROUNDS)
            if not len(pulls) and not joins.any():
                break
            touching = touching | joins
            touching[pulls] = False
            dropped[pulls] = True
        unknowns = np.zeros(len(right))
        unknowns[at] = found
        return ActiveSet(touching=touching, unknowns=unknowns, push_sd=np.where(touching, 0.0, push))

    def _push_information(self, normal: np.ndarray) -> Float[np.ndarray, " m"]:
        """Diagonal of G' W G of the markers in view, pushes only: information without prior, 1/N^2."""
        rows = slice(2, self._size, 3)
        full = np.diag(self._data)[rows]
        return np.asarray(np.maximum(full + (np.diag(normal) - np.diag(self._normal))[rows], 1e-9 * full))

    def _single_node_sd(
        self,
        normal: np.ndarray,
        right: np.ndarray,
        motion_mm: float,
        push_information: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"]:
        """Each node's push in standard deviations, fitted as the only one besides the smooth fields."""
        size = 3 * len(self.grid.nodes_mm)
        rows = slice(2, size, 3)
        smooth = cho_factor(normal[size:, size:] + np.diag(_smooth_precision(motion_mm)), lower=True)
        across = normal[rows, size:]
        left = right[rows] - across @ cho_solve(smooth, right[size:])
        spread = push_information - np.einsum("ij,ji->i", across, cho_solve(smooth, across.T))
        return np.asarray(left / np.sqrt(np.maximum(spread, 1e-12 * push_information)))


def most_likely_hyperparameters(
    grid: GelGrid,
    information_per_mm2: Float[np.ndarray, "n 3 3"],
    frames_mm: Sequence[Float[np.ndarray, "n 3"]] | Float[np.ndarray, "f n 3"],
    *,
    observed: Float[np.ndarray, "3*n u"] | None = None,
    start: PriorHyperparameters = INITIAL_HYPERPARAMETERS,
    rounds: int = 2,
) -> PriorHyperparameters:
    """The hyperparameters of greatest marginal likelihood over some loaded frames, by factors of two.

    The contact is found anew after every round of climbing.
    """
    best = start
    seen = _moved(grid) if observed is None else observed
    for turn in range(rounds):
        everywhere = np.ones(len(grid.nodes_mm), dtype=bool)
        touching = [everywhere for _ in frames_mm]
        if turn:
            solver = InvertedForce(grid, information_per_mm2, best, observed=observed)
            touching = [solver.solve(y).touching for y in frames_mm]
        pairs = [(y, c) for y, c in zip(frames_mm, touching, strict=True) if c.any()]
        if not pairs:
            return best
        statistics = [_sufficient_statistics(seen, information_per_mm2, y, c) for y, c in pairs]
        value = _evidence(grid, best, statistics)
        for name in ORDER_OF_CLIMBING:
            for factor in (2.0, 0.5):
                for _ in range(4):
                    trial = replace(best, **{name: getattr(best, name) * factor})
                    if trial.noise < 0.99 or (found := _evidence(grid, trial, statistics)) <= value:
                        break
                    best, value = trial, found
    return best


@dataclass(frozen=True, kw_only=True)
class SufficientStatistics:
    """Sufficient statistics of one frame for the forces on its touching nodes, before noise and prior are
    scaled.
    """

    touching: Bool[np.ndarray, " m"]
    normal: Float[np.ndarray, "a a"]
    right: Float[np.ndarray, " a"]
    misfit: float
    directions: int
    motion_mm: float


def _sufficient_statistics(
    seen: np.ndarray, information: np.ndarray, y: np.ndarray, touching: np.ndarray
) -> SufficientStatistics:
    """Normal matrix, right side and misfit of one frame whose contact is known."""
    usable = np.isfinite(y).all(axis=1)
    at = np.concatenate([_dofs(touching), np.arange(3 * len(touching), seen.shape[1])])
    G = seen[:, at].reshape(len(y), 3, -1)[usable]
    W = information[usable]
    weighted, flat = np.matmul(W, G).reshape(-1, G.shape[2]), G.reshape(-1, G.shape[2])
    return SufficientStatistics(
        touching=touching,
        normal=weighted.T @ flat,
        right=weighted.T @ y[usable].ravel(),
        misfit=float(np.einsum("ni,nij,nj->", y[usable], W, y[usable])),
        directions=int(np.linalg.matrix_rank(information[0], hermitian=True, rtol=1e-6)) * int(usable.sum()),
        motion_mm=_motion(np.where(usable[:, None], y, 0.0)),
    )


def _evidence(
    grid: GelGrid, hyperparameters: PriorHyperparameters, statistics: Sequence[SufficientStatistics]
) -> float:
    """Log marginal likelihood of frames whose contacts are known, up to a constant of the sensor."""
    total = 0.0
    prior = _prior(grid, hyperparameters)
    for frame in statistics:
        at = _dofs(frame.touching)
        Q = prior[np.ix_(at, at)]
        normal = frame.normal / hyperparameters.noise**2
        normal[: len(at), : len(at)] += Q
        normal[len(at) :, len(at) :] += np.diag(_smooth_precision(frame.motion_mm))
        factor = cho_factor(normal, lower=True)
        right = frame.right / hyperparameters.noise**2
        smooth = Q[::3, ::3]
        log_prior = np.log(np.diag(cholesky(smooth, lower=True))).sum()
        sizes = np.log([Q[k, k] / Q[0, 0] for k in range(3)]).sum() * len(smooth) / 2
        total += float(
            0.5 * (right @ cho_solve(factor, right) - frame.misfit / hyperparameters.noise**2)
            - np.log(np.diag(factor[0])).sum()
            + 3 * log_prior
            + sizes
            - frame.directions * np.log(hyperparameters.noise)
        )
    return total


def _prior(grid: GelGrid, hyperparameters: PriorHyperparameters) -> Float[np.ndarray, "d d"]:
    m = len(grid.nodes_mm)
    smooth = np.eye(m) + hyperparameters.roughness**2 * grid.laplacian
    area = grid.pitch_mm**2
    out = np.zeros((m, 3, m, 3))
    for k, sd in enumerate(
        (hyperparameters.shear_MPa, hyperparameters.shear_MPa, hyperparameters.pressure_MPa)
    ):
        out[:, k, :, k] = smooth / (sd * area) ** 2
    return out.reshape(3 * m, 3 * m)


def _moved(grid: GelGrid) -> Float[np.ndarray, "d u"]:
    return with_smooth(grid, grid.compliance, grid.rest_mm[:, :2])


def _motion(y: Float[np.ndarray, "n 3"]) -> float:
    return max(float(np.linalg.norm(y, axis=1).max()), LEAST_MOTION_MM)


def _smooth_precision(motion_mm: float) -> Float[np.ndarray, " s"]:
    return np.tile(1.0 / (SMOOTH_SHARE * motion_mm) ** 2, 6)


def _factored(matrix: Float[np.ndarray, "u u"]) -> tuple[tuple[np.ndarray, bool], Float[np.ndarray, " u"]]:
    """Cholesky's factor, and the standard deviations that the inverse states."""
    factor = cho_factor(matrix, lower=True)
    inverse = lapack.dtrtri(factor[0], lower=1)[0]
    return factor, np.sqrt((np.tril(inverse) ** 2).sum(axis=0))


def _dofs(touching: np.ndarray) -> np.ndarray:
    return np.asarray((3 * np.flatnonzero(touching)[:, None] + np.arange(3)).ravel())

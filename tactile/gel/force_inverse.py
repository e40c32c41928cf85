"""From the displacement of a gel's face to the forces on it: a linear inverse.

Unknowns are forces t on the nodes of a square grid (tents of traction, tactile.gel.slab). Marker
displacements y with information W (inverse covariance; zero along what a camera cannot see) and a Gaussian
prior of precision Q = (1 + roughness^2 Laplacian) / sd^2 on each component give

    L t = G' W y,    L = G' W G + Q,    covariance of t = L^-1

on the nodes in contact; t = 0 outside, and pressure is positive inside (an active set, from the unbound
solution, with nodes dropped that would pull and neighbours added that want to push). G' W and L are made once
per sensor. G is continued by smooth fields that no force makes (quadratics over the pad, a percent or two of
the displacement): what free sides and a housing do to a slab that is not endless. They matter: an almost
incompressible gel is so stiff against even pressure that 5 um of even depth are 5 % of a press of 3 N. The
prior (tactile.gel.force_prior) is that of greatest marginal likelihood (tactile.gel.force_likelihood).

Because t is linear in y, force and displacement share their noise: `InvertedForce.joint_covariance` has both.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_factor, cho_solve, cholesky, lapack

from tactile.gel.force_prior import (
    USUAL_MOTION_MM,
    PriorHyperparameters,
    displacement_by,
    dofs_of,
    motion_of,
    prior_precision,
    smooth_precision,
)
from tactile.gel.grid import GelGrid

TOUCHES_AT_SD, STARTS_AT = 4.0, 0.3
"""A node is in contact at first where it is pushed by so many standard deviations, or by such a share of the
most. Set by hand."""
GROWS_AT_SD = 1.0
"""A node beside the contact joins it where it would be pushed by so many standard deviations."""
APPEARS_AT_SD = 6.0
"""A node away from it needs more: among hundreds of nodes 4 would come by chance now and then. Set by
hand."""
MOST_ROUNDS = 40
"""In which nodes may join; then they only leave, so that the search ends. Set by hand."""
OF_PEAK = (0.15, 0.4)
"""Where depth is not seen: nodes with such a share of the greatest pressure are starts of the search too. Set
by hand."""


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Which nodes touch, the unknowns (0 outside), each outer node's push in standard deviations, and ln of
    the frame's marginal likelihood with these nodes, up to a constant of the frame and its noise.
    """

    touching: Bool[np.ndarray, " m"]
    unknowns: Float[np.ndarray, " u"]
    push_sd: Float[np.ndarray, " m"]
    log_likelihood: float


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
        self.grid = grid
        self.information = information_per_mm2 / hyperparameters.noise**2
        self._observed_by = displacement_by(grid) if observed is None else observed
        self._moved_by = displacement_by(grid)
        per_marker = self._observed_by.reshape(len(grid.rest_mm), 3, -1)
        self._weighted = np.matmul(self.information, per_marker).reshape(self._observed_by.shape)
        self._data = self._weighted.T @ self._observed_by
        self._size = 3 * len(grid.nodes_mm)
        self._adjacent = grid.laplacian < 0
        self.sees_depth = bool(np.linalg.matrix_rank(information_per_mm2[0], hermitian=True, rtol=1e-6) == 3)
        self._take(hyperparameters)

    def _take(self, hyperparameters: PriorHyperparameters) -> None:
        size = self._size
        self.hyperparameters = hyperparameters
        self._prior = prior_precision(self.grid, hyperparameters)
        self._normal = self._data.copy()
        self._normal[:size, :size] += self._prior
        loose = self._normal.copy()
        loose[size:, size:] += np.diag(smooth_precision(self.grid, USUAL_MOTION_MM))
        self._free = _factored(loose)

    def with_prior(self, hyperparameters: PriorHyperparameters) -> "InvertedForce":
        """The same gel and sensor with another prior of forces; the noise stays as it is."""
        other = copy(self)
        other._take(replace(hyperparameters, noise=self.hyperparameters.noise))
        return other

    def solve(
        self,
        displacement_mm: Float[np.ndarray, "n 3"],
        seen: Bool[np.ndarray, " n"] | None = None,
        *,
        before: Bool[np.ndarray, " m"] | None = None,
    ) -> GelContact:
        """One frame; markers that are not `seen` (or NaN) are left out. `before`: what touched before."""
        y, normal, right = self._observed(displacement_mm, seen)
        motion_mm = motion_of(y)
        found = self._solved_active_set(normal, right, motion_mm, before)
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
        return self._solved_active_set(normal, right, motion_of(y))

    def _block(
        self, touching: Bool[np.ndarray, " m"], motion_mm: float, normal: np.ndarray | None = None
    ) -> Float[np.ndarray, "a a"]:
        """The normal matrix of the unknowns in play, the smooth fields held in proportion to the motion."""
        at = self._at(touching)
        block = (self._normal if normal is None else normal)[np.ix_(at, at)]
        end = np.arange(len(at) - (len(self._normal) - self._size), len(at))
        block[end, end] += smooth_precision(self.grid, motion_mm)
        return np.asarray(block)

    def _at(self, touching: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " a"]:
        """Unknowns in play: the touching nodes' forces and the smooth fields."""
        smooth = np.arange(3 * len(touching), len(self._normal))
        return np.concatenate([dofs_of(touching), smooth])

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

    def _solved_active_set(
        self,
        normal: np.ndarray,
        right: np.ndarray,
        motion_mm: float,
        before: Bool[np.ndarray, " m"] | None = None,
    ) -> ActiveSet:
        """The active set.

        Without depth there is more than one in which no node pulls and none outside pushes, some with a
        force twice too great: the search starts from several, and the most likely one is taken.
        """
        information = self._push_information(normal)
        first = self._first_touching(normal, right, motion_mm, information)
        found = self._stationary(first, normal, right, motion_mm, information)
        if self.sees_depth or not first.any():
            return found
        starts = [] if before is None or not before.any() else [before | (self._adjacent @ before)]
        pressure = np.maximum(found.unknowns[2 : self._size : 3], 0.0)
        smoothed = pressure + self._adjacent @ pressure / self._adjacent.sum(axis=1)
        starts += [smoothed > share * smoothed.max() for share in OF_PEAK]
        others = [self._stationary(start, normal, right, motion_mm, information) for start in starts]
        return max([found, *others], key=lambda one: one.log_likelihood)

    def _first_touching(
        self, normal: np.ndarray, right: np.ndarray, motion_mm: float, push_information: np.ndarray
    ) -> Bool[np.ndarray, " m"]:
        """Nodes that push where nothing binds them and that alone would be seen; none where none would be."""
        normal_rows = slice(2, self._size, 3)
        factor, sd = self._free
        if normal is not self._normal:
            loose = normal.copy()
            loose[self._size :, self._size :] += np.diag(smooth_precision(self.grid, USUAL_MOTION_MM))
            factor, sd = _factored(loose)
        free = cho_solve(factor, right, check_finite=False)[normal_rows]
        single_node_sd = self._single_node_sd(normal, right, motion_mm, push_information)
        # sure where depth is seen; where it is not, every node is unsure and a good part of the peak must do
        sure = np.minimum(TOUCHES_AT_SD * sd[normal_rows], STARTS_AT * free.max())
        touching = (free > sure) & (single_node_sd > APPEARS_AT_SD)
        touching[np.argmax(single_node_sd)] |= single_node_sd.max() > APPEARS_AT_SD
        return np.asarray(touching)

    def _stationary(
        self,
        touching: Bool[np.ndarray, " m"],
        normal: np.ndarray,
        right: np.ndarray,
        motion_mm: float,
        push_information: np.ndarray,
    ) -> ActiveSet:
        """The active set reached from here: nodes that pull leave, neighbours that push join; once a set
        comes back, nodes only leave.
        """
        normal_rows = slice(2, self._size, 3)
        met, grows = set[bytes](), True
        while True:
            at = self._at(touching)
            factor = cho_factor(
                self._block(touching, motion_mm, normal), lower=True, overwrite_a=True, check_finite=False
            )
            found = cho_solve(factor, right[at], check_finite=False)
            push = (right[normal_rows] - normal[normal_rows][:, at] @ found) / np.sqrt(push_information)
            pulls = np.zeros_like(touching)
            pulls[touching] = found[2 : 3 * int(touching.sum()) : 3] < 0
            least = np.where(self._adjacent @ touching, GROWS_AT_SD, APPEARS_AT_SD)
            joins = ~touching & (push > least) & (grows and touching.any())
            if not pulls.any() and not joins.any():
                break
            touching = (touching & ~pulls) | joins
            grows = grows and len(met) < MOST_ROUNDS and touching.tobytes() not in met
            met.add(touching.tobytes())
        unknowns = np.zeros(len(right))
        unknowns[at] = found
        forces = dofs_of(touching)
        log_prior = np.linalg.slogdet(self._prior[np.ix_(forces, forces)])[1] if len(forces) else 0.0
        log_likelihood = (right[at] @ found + log_prior) / 2 - np.log(np.diag(factor[0])).sum()
        return ActiveSet(
            touching=touching,
            unknowns=unknowns,
            push_sd=np.where(touching, 0.0, push),
            log_likelihood=float(log_likelihood),
        )

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
        smooth = cho_factor(
            normal[size:, size:] + np.diag(smooth_precision(self.grid, motion_mm)), lower=True
        )
        across = normal[rows, size:]
        left = right[rows] - across @ cho_solve(smooth, right[size:])
        spread = push_information - np.einsum("ij,ji->i", across, cho_solve(smooth, across.T))
        return np.asarray(left / np.sqrt(np.maximum(spread, 1e-12 * push_information)))


def _factored(matrix: Float[np.ndarray, "u u"]) -> tuple[tuple[np.ndarray, bool], Float[np.ndarray, " u"]]:
    """Cholesky's factor, and the standard deviations that the inverse states."""
    factor = cho_factor(matrix, lower=True)
    inverse = lapack.dtrtri(factor[0], lower=1)[0]
    return factor, np.sqrt((np.tril(inverse) ** 2).sum(axis=0))

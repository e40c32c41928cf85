"""From the displacement of a gel's face to the forces on it: a linear inverse.

Unknowns are forces t on the nodes of a square grid (tents of traction, tactile.gel.slab). Marker
displacements y with information W (inverse covariance; zero along what a camera cannot see) and a Gaussian
prior of precision Q = (1 + roughness^2 Laplacian) / sd^2 on each component give

    L t = G' W y,    L = G' W G + Q,    covariance of t = L^-1

on the nodes in contact; t = 0 outside, and pressure is positive inside (an active set, from the unbound
solution, with nodes dropped that would pull and neighbours added that want to push). What frames share is
computed once (tactile.gel.normal_equations). G is continued by smooth fields that no force makes (quadratics
over the pad, a percent or two of the displacement): what free sides and a housing do to a slab that is not
endless. They matter: an almost incompressible gel is so stiff against even pressure that 5 um of even depth
are 5 % of a press of 3 N. The prior (tactile.gel.grid) is that of greatest marginal likelihood
(tactile.gel.force_likelihood).

Because t is linear in y, force and displacement share their noise: `InvertedForce.joint_covariance` has both.
"""

from collections import OrderedDict
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import blas

from tactile.gel.grid import (
    USUAL_MOTION_MM,
    GelGrid,
    PriorDeterminant,
    PriorHyperparameters,
    displacement_by,
    dofs_of,
    motion_of,
    prior_precision,
    smooth_precision,
)
from tactile.gel.normal_equations import FreeFactor, NormalEquations, cholesky_of, rows_of

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
KEPT_VIEWS = 3
"""Sets of markers in view whose equations are kept: frames that are solved in turn. Set by hand."""


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


def sees_depth(information_per_mm2: Float[np.ndarray, "n 3 3"]) -> bool:
    """Whether markers are seen in three directions; they are all seen by the same cameras."""
    return bool(np.linalg.matrix_rank(information_per_mm2[0], hermitian=True, rtol=1e-6) == 3)


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
        self._moved_by = displacement_by(grid)
        self._observed_by = self._moved_by if observed is None else observed
        per_marker = self._observed_by.reshape(len(grid.rest_mm), 3, -1)
        self._weighted = np.matmul(self.information, per_marker).reshape(self._observed_by.shape)
        self._data = self._weighted.T @ self._observed_by
        self._size = 3 * len(grid.nodes_mm)
        self._adjacent_nodes = _neighbours(grid.laplacian < 0)
        self.sees_depth = sees_depth(information_per_mm2)
        self._take(hyperparameters)

    def _take(self, hyperparameters: PriorHyperparameters) -> None:
        size = self._size
        self.hyperparameters = hyperparameters
        normal = self._data.copy()
        normal[:size, :size] += prior_precision(self.grid, hyperparameters)
        self._equations = NormalEquations(
            normal,
            len(self.grid.nodes_mm),
            PriorDeterminant(self.grid, hyperparameters),
            FreeFactor(normal, smooth_precision(self.grid, USUAL_MOTION_MM)),
        )
        self._in_view = OrderedDict[bytes, NormalEquations]()

    def with_prior(self, hyperparameters: PriorHyperparameters) -> "InvertedForce":
        """The same gel and sensor with another prior of forces; the noise stays as it is."""
        other = copy(self)
        other._take(replace(hyperparameters, noise=self.hyperparameters.noise))
        return other

    def solve(
        self,
        displacement_mm: Float[np.ndarray, "n 3"],
        *,
        before: Bool[np.ndarray, " m"] | None = None,
    ) -> GelContact:
        """One frame; markers that are NaN are left out. `before`: what touched before."""
        y, equations, right = self._observed(displacement_mm)
        motion_mm = motion_of(y)
        active_set = self._solved_active_set(equations, right, motion_mm, before)
        t = active_set.unknowns[: self._size].reshape(-1, 3)
        at = self._at(active_set.touching)
        return GelContact(
            node_force_N=t,
            touching=active_set.touching,
            motion_mm=motion_mm,
            force_N=self.grid.to_markers @ t,
            displacement_mm=(self._moved_by[:, at] @ active_set.unknowns[at]).reshape(y.shape),
        )

    def active_set(self, displacement_mm: Float[np.ndarray, "n 3"]) -> ActiveSet:
        """The active set of one frame: no touching node pulls, none outside pushes by six times the noise."""
        y, equations, right = self._observed(displacement_mm)
        return self._solved_active_set(equations, right, motion_of(y))

    def _at(self, touching: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " a"]:
        """Unknowns in play: the touching nodes' forces and the smooth fields."""
        smooth = np.arange(3 * len(touching), self._observed_by.shape[1])
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
        root = self._root(touching, motion_mm)
        half = root @ self._to_markers(touching, len(root)).T
        posterior = half.T @ half
        cross = noise @ linear.T
        return np.block([[noise, cross], [cross.T, posterior]])

    def linear_map(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "d d"]:
        """K in force = K displacement, N/mm, while these nodes touch."""
        at = self._at(touching)
        root = self._root(touching, motion_mm)
        return np.asarray(self._to_markers(touching, len(at)) @ (root.T @ (root @ self._weighted[:, at].T)))

    def _to_markers(self, touching: Bool[np.ndarray, " m"], unknowns: int) -> Float[np.ndarray, "d a"]:
        forces = np.kron(self.grid.to_markers[:, touching], np.eye(3))
        return np.pad(forces, ((0, 0), (0, unknowns - forces.shape[1])))

    def force_spread(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "n 3"]:
        """Standard deviation that the frame's noise and the prior leave in marker force, N."""
        return self._force_sd(touching, self._root(touching, motion_mm))

    def spreads(
        self, touching: Bool[np.ndarray, " m"], motion_mm: float
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """`force_spread`, and the same of the face's motion along its normal that the forces make, mm."""
        root = self._root(touching, motion_mm)
        moved = root @ self._moved_by[2::3, self._at(touching)].T
        return self._force_sd(touching, root), np.asarray(np.sqrt((moved**2).sum(axis=0)))

    def _force_sd(
        self, touching: Bool[np.ndarray, " m"], root: Float[np.ndarray, "a a"]
    ) -> Float[np.ndarray, "n 3"]:
        if not touching.any():
            return np.zeros(self.grid.rest_mm.shape)
        end, shares = 3 * int(touching.sum()), self.grid.to_markers[:, touching].T
        force = [root[:, k:end:3] @ shares for k in range(3)]
        return np.asarray(np.sqrt(np.stack([(component**2).sum(axis=0) for component in force], axis=1)))

    def _root(self, touching: Bool[np.ndarray, " m"], motion_mm: float) -> Float[np.ndarray, "a a"]:
        """A root of the covariance of the unknowns in play: R' R."""
        smooth = smooth_precision(self.grid, motion_mm)
        return self._equations.factor(touching).covariance_root(smooth)

    def _observed(self, displacement_mm: np.ndarray) -> tuple[np.ndarray, NormalEquations, np.ndarray]:
        """Displacement (0 where unknown), equations and right side of the markers that are known."""
        usable = np.isfinite(displacement_mm).all(axis=1)
        y = np.where(usable[:, None], displacement_mm, 0.0)
        weighted = np.matmul(self.information, y[:, :, None]).ravel()
        return y, self._equations_of(usable), weighted @ self._observed_by

    def _equations_of(self, usable: Bool[np.ndarray, " n"]) -> NormalEquations:
        """The equations of these markers; those of the last few frames are kept."""
        if usable.all():
            return self._equations
        key = usable.tobytes()
        if (equations := self._in_view.pop(key, None)) is None:
            lost = np.flatnonzero(~usable)
            rows = (3 * lost[:, None] + np.arange(3)).ravel()
            equations = self._equations.without(rows_of(self._observed_by[rows], self.information[lost]))
        self._in_view[key] = equations
        if len(self._in_view) > KEPT_VIEWS:
            self._in_view.popitem(last=False)
        return equations

    def _solved_active_set(
        self,
        equations: NormalEquations,
        right: np.ndarray,
        motion_mm: float,
        before: Bool[np.ndarray, " m"] | None = None,
    ) -> ActiveSet:
        """The active set.

        Without depth there is more than one in which no node pulls and none outside pushes, some with a
        force twice too great: the search starts from several, and the most likely one is taken.
        """
        full = np.diag(self._data)[2 : self._size : 3]
        information = np.maximum(full - equations.pressure_lost, 1e-9 * full)
        first = self._first_touching(equations, right, motion_mm, information)
        active_set = self._stationary(first, equations, right, motion_mm, information)
        if self.sees_depth or not first.any():
            return active_set
        starts = [] if before is None or not before.any() else [before | self._adjacent(before)]
        pressure = np.maximum(active_set.unknowns[2 : self._size : 3], 0.0)
        around = np.append(pressure, 0.0)[self._adjacent_nodes].sum(axis=1)
        smoothed = pressure + around / (self._adjacent_nodes < len(pressure)).sum(axis=1)
        starts += [smoothed > share * smoothed.max() for share in OF_PEAK]
        others = [self._stationary(start, equations, right, motion_mm, information) for start in starts]
        return max([active_set, *others], key=lambda candidate: candidate.log_likelihood)

    def _adjacent(self, nodes: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
        """The nodes that have one of these beside them."""
        return np.asarray(np.append(nodes, False)[self._adjacent_nodes].any(axis=1))

    def _first_touching(
        self, equations: NormalEquations, right: np.ndarray, motion_mm: float, push_information: np.ndarray
    ) -> Bool[np.ndarray, " m"]:
        """Nodes that push where nothing binds them and that alone would be seen; none where none would be."""
        free, sd = equations.free.pressures(right)
        single_node_sd = self._single_node_sd(equations, right, motion_mm, push_information)
        # sure where depth is seen; where it is not, every node is unsure and a good part of the peak must do
        sure = np.minimum(TOUCHES_AT_SD * sd, STARTS_AT * free.max())
        touching = (free > sure) & (single_node_sd > APPEARS_AT_SD)
        touching[np.argmax(single_node_sd)] |= single_node_sd.max() > APPEARS_AT_SD
        return np.asarray(touching)

    def _stationary(
        self,
        touching: Bool[np.ndarray, " m"],
        equations: NormalEquations,
        right: np.ndarray,
        motion_mm: float,
        push_information: np.ndarray,
    ) -> ActiveSet:
        """The active set reached from here: nodes that pull leave, neighbours that push join; once a set
        comes back, nodes only leave.
        """
        smooth = smooth_precision(self.grid, motion_mm)
        pushed, push_sd = right[2 : self._size : 3], np.sqrt(push_information)
        met, grows = set[bytes](), True
        while True:
            factor = equations.factor(touching)
            forces, fields, log_det_root = factor.solved(right, smooth)
            push = (pushed - equations.resisted(factor.at, forces, fields)) / push_sd
            pulls = np.zeros_like(touching)
            pulls[touching] = forces[2::3] < 0
            least = np.where(self._adjacent(touching), GROWS_AT_SD, APPEARS_AT_SD)
            joins = ~touching & (push > least) & (grows and touching.any())
            if not pulls.any() and not joins.any():
                break
            touching = (touching & ~pulls) | joins
            grows = grows and len(met) < MOST_ROUNDS and touching.tobytes() not in met
            met.add(touching.tobytes())
        unknowns = np.zeros(len(right))
        unknowns[factor.at], unknowns[self._size :] = forces, fields
        log_det_prior = equations.log_det_prior(np.flatnonzero(touching))
        return ActiveSet(
            touching=touching,
            unknowns=unknowns,
            push_sd=np.where(touching, 0.0, push),
            log_likelihood=float((right @ unknowns + log_det_prior) / 2 - log_det_root),
        )

    def _single_node_sd(
        self,
        equations: NormalEquations,
        right: np.ndarray,
        motion_mm: float,
        push_information: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"]:
        """Each node's push in standard deviations, fitted as the only one besides the smooth fields."""
        smooth = cholesky_of(equations.fields + np.diag(smooth_precision(self.grid, motion_mm)))
        across = blas.dtrsm(1.0, smooth, equations.fields_by_pressure.T, lower=1)
        pushed = right[2 : self._size : 3] - blas.dtrsv(smooth, right[self._size :], lower=1) @ across
        spread = push_information - (across**2).sum(axis=0)
        return np.asarray(pushed / np.sqrt(np.maximum(spread, 1e-12 * push_information)))


def _neighbours(adjacent: Bool[np.ndarray, "m m"]) -> Int[np.ndarray, "m k"]:
    """Of every node those beside it; where it has fewer than others, the number of nodes."""
    most = int(adjacent.sum(axis=1).max())
    first = np.argsort(~adjacent, axis=1, kind="stable")[:, :most]
    return np.where(np.take_along_axis(adjacent, first, axis=1), first, len(adjacent))

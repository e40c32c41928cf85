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
are 5 % of a press of 3 N. The prior (tactile.gel.grid) is that of greatest marginal likelihood of loaded
frames,

    2 log p = t' L t - y' W y - log det L + log det Q + log det W      (constants left out; MacKay 1992)

over the prior's spread and roughness, and by how much the noise exceeds what frames in the air show.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.gel.grid import (
    INITIAL_HYPERPARAMETERS,
    USUAL_MOTION_MM,
    GelGrid,
    PriorHyperparameters,
    displacement_by,
    dofs_of,
    log_det_prior,
    motion_of,
    prior_precision,
    smooth_precision,
)
from tactile.gel.normal_equations import NormalEquations, forward, lower_root

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
    """One frame solved: which nodes touch, forces (N) of the markers, and what the slab shows for them."""

    touching: Bool[np.ndarray, " m"]
    force_N: Float[np.ndarray, "n 3"]
    displacement_mm: Float[np.ndarray, "n 3"]


def sees_depth(information_per_mm2: Float[np.ndarray, "n 3 3"]) -> bool:
    """Whether markers are seen in three directions; they are all seen by the same cameras."""
    return bool(np.linalg.matrix_rank(information_per_mm2[0], hermitian=True, rtol=1e-6) == 3)


class InvertedForce:
    """The inverse of one gel, ready for frames: everything that frames share is computed here.

    `information_per_mm2` (n, 3, 3) is the inverse covariance of one frame's marker displacement as frames in
    the air show it.
    """

    def __init__(
        self,
        grid: GelGrid,
        information_per_mm2: Float[np.ndarray, "n 3 3"],
        hyperparameters: PriorHyperparameters,
    ) -> None:
        self.grid = grid
        self._in_the_air = information_per_mm2
        self._moved_by = displacement_by(grid)
        self._size = 3 * len(grid.nodes_mm)
        self._adjacent_nodes = _neighbours(grid.laplacian < 0)
        self.sees_depth = sees_depth(information_per_mm2)
        weighted = np.matmul(information_per_mm2, self._moved_by.reshape(len(grid.rest_mm), 3, -1))
        self._data = weighted.reshape(self._moved_by.shape).T @ self._moved_by
        self._take(hyperparameters)

    def _take(self, hyperparameters: PriorHyperparameters) -> None:
        self.hyperparameters = hyperparameters
        self.information = self._in_the_air / hyperparameters.noise**2
        normal = self._data / hyperparameters.noise**2
        information = np.diag(normal)[2 : self._size : 3].copy()
        normal[: self._size, : self._size] += prior_precision(self.grid, hyperparameters)
        usual = smooth_precision(self.grid, USUAL_MOTION_MM)
        self._whole = NormalEquations(normal, information, usual)
        self._in_view = dict[bytes, NormalEquations]()

    def with_prior(self, hyperparameters: PriorHyperparameters) -> "InvertedForce":
        """The same gel and sensor with another prior of forces and another noise."""
        other = copy(self)
        other._take(hyperparameters)
        return other

    def solve(
        self,
        displacement_mm: Float[np.ndarray, "n 3"],
        *,
        before: Bool[np.ndarray, " m"] | None = None,
    ) -> GelContact:
        """One frame; markers that are NaN are left out. `before`: what touched before."""
        y, equations, right = self._observed(displacement_mm)
        active_set = self._solved_active_set(equations, right, motion_of(y), before)
        t = active_set.unknowns[: self._size].reshape(-1, 3)
        return GelContact(
            touching=active_set.touching,
            force_N=self.grid.to_markers @ t,
            displacement_mm=(self._moved_by @ active_set.unknowns).reshape(y.shape),
        )

    def active_set(self, displacement_mm: Float[np.ndarray, "n 3"]) -> ActiveSet:
        """The active set of one frame: no touching node pulls, none outside pushes by six times the noise."""
        y, equations, right = self._observed(displacement_mm)
        return self._solved_active_set(equations, right, motion_of(y))

    def log_evidence(
        self, displacement_mm: Float[np.ndarray, "n 3"], touching: Bool[np.ndarray, " m"]
    ) -> float:
        """ln of the marginal likelihood of a frame whose contact is known, up to a constant of the sensor."""
        y, equations, right = self._observed(displacement_mm)
        smooth = smooth_precision(self.grid, motion_of(y))
        forces, fields, log_det_root = equations.factor(touching).solved(right, smooth)
        fitted = right[dofs_of(touching)] @ forces + right[self._size :] @ fields
        misfit = float(np.einsum("ni,nij,nj->", y, self.information, y))
        directions = (3 if self.sees_depth else 2) * int(np.isfinite(displacement_mm).all(axis=1).sum())
        log_det = log_det_prior(self.grid, self.hyperparameters, touching) / 2 - log_det_root
        return float((fitted - misfit) / 2 + log_det - directions * np.log(self.hyperparameters.noise))

    def _observed(self, displacement_mm: np.ndarray) -> tuple[np.ndarray, NormalEquations, np.ndarray]:
        """Displacement (0 where unknown), equations and right side of the markers that are known."""
        usable = np.isfinite(displacement_mm).all(axis=1)
        y = np.where(usable[:, None], displacement_mm, 0.0)
        weighted = np.matmul(self.information, y[:, :, None]).ravel()
        return y, self._equations_of(usable), weighted @ self._moved_by

    def _equations_of(self, usable: Bool[np.ndarray, " n"]) -> NormalEquations:
        """The equations of these markers; those of the last few sets are kept."""
        if usable.all():
            return self._whole
        key = usable.tobytes()
        if key not in self._in_view:
            values, vectors = np.linalg.eigh(self.information[~usable])
            roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]).transpose(0, 2, 1)
            moved_by = self._moved_by.reshape(len(usable), 3, -1)[~usable]
            rows = np.matmul(roots, moved_by).reshape(-1, moved_by.shape[2])
            if len(self._in_view) >= KEPT_VIEWS:
                self._in_view.pop(next(iter(self._in_view)))
            self._in_view[key] = self._whole.without(rows)
        return self._in_view[key]

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
        first = self._first_touching(equations, right, motion_mm)
        active_set = self._stationary(first, equations, right, motion_mm)
        if self.sees_depth or not first.any():
            return active_set
        starts = [] if before is None or not before.any() else [before | self._adjacent(before)]
        pressure = np.maximum(active_set.unknowns[2 : self._size : 3], 0.0)
        around = np.append(pressure, 0.0)[self._adjacent_nodes].sum(axis=1)
        smoothed = pressure + around / (self._adjacent_nodes < len(pressure)).sum(axis=1)
        starts += [smoothed > share * smoothed.max() for share in OF_PEAK]
        others = [self._stationary(start, equations, right, motion_mm) for start in starts]
        return max([active_set, *others], key=lambda candidate: candidate.log_likelihood)

    def _adjacent(self, nodes: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
        """The nodes that have one of these beside them."""
        return np.asarray(np.append(nodes, False)[self._adjacent_nodes].any(axis=1))

    def _first_touching(
        self, equations: NormalEquations, right: np.ndarray, motion_mm: float
    ) -> Bool[np.ndarray, " m"]:
        """Nodes that push where nothing binds them and that alone would be seen; none where none would be."""
        free = equations.free_pressures(right)
        single_node_sd = self._single_node_sd(equations, right, motion_mm)
        # without depth every node is unsure, and a good part of the peak must do
        sure = STARTS_AT * free.max()
        if self.sees_depth:
            sure = np.minimum(TOUCHES_AT_SD * equations.free_sd, sure)
        touching = (free > sure) & (single_node_sd > APPEARS_AT_SD)
        touching[np.argmax(single_node_sd)] |= single_node_sd.max() > APPEARS_AT_SD
        return np.asarray(touching)

    def _stationary(
        self,
        touching: Bool[np.ndarray, " m"],
        equations: NormalEquations,
        right: np.ndarray,
        motion_mm: float,
    ) -> ActiveSet:
        """The active set reached from here: nodes that pull leave, neighbours that push join; once a set
        comes back, nodes only leave.
        """
        smooth = smooth_precision(self.grid, motion_mm)
        pushed, push_sd = right[2 : self._size : 3], np.sqrt(equations.push_information)
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
        log_det = log_det_prior(self.grid, self.hyperparameters, touching) / 2 - log_det_root
        return ActiveSet(
            touching=touching,
            unknowns=unknowns,
            push_sd=np.where(touching, 0.0, push),
            log_likelihood=float(right @ unknowns / 2 + log_det),
        )

    def _single_node_sd(
        self, equations: NormalEquations, right: np.ndarray, motion_mm: float
    ) -> Float[np.ndarray, " m"]:
        """Each node's push in standard deviations, fitted as the only one besides the smooth fields."""
        information = equations.push_information
        smooth = lower_root(equations.fields + np.diag(smooth_precision(self.grid, motion_mm)))
        across = forward(smooth, equations.fields_by_pressure.T)
        pushed = right[2 : self._size : 3] - forward(smooth, right[self._size :]) @ across
        spread = information - (across**2).sum(axis=0)
        return np.asarray(pushed / np.sqrt(np.maximum(spread, 1e-12 * information)))


def _neighbours(adjacent: Bool[np.ndarray, "m m"]) -> Int[np.ndarray, "m k"]:
    """Of every node those beside it; where it has fewer than others, the number of nodes."""
    most = int(adjacent.sum(axis=1).max())
    first = np.argsort(~adjacent, axis=1, kind="stable")[:, :most]
    return np.where(np.take_along_axis(adjacent, first, axis=1), first, len(adjacent))


ORDER_OF_CLIMBING = ("pressure_MPa", "shear_MPa", "noise", "roughness", "pressure_MPa", "shear_MPa", "noise")
"""Of the search, one hyperparameter after the other; the first ones again, as they trade with the last."""
CLIMBED_WITH_CONTACT = ("roughness", "pressure_MPa", "shear_MPa", "roughness", "pressure_MPa", "shear_MPa")
"""Likewise, where the contact is found anew at every step."""
ROUNDS = 2
"""Of climbing: with every node in contact, then with the contact found by the first. Set by hand."""
LEAST_NOISE = 0.99
"""Over the noise of frames in the air, which is the least: 1, but for rounding."""
DRAGGED = 0.4
"""Share of one direction in the motion of a gel from which it is dragged: 0.54 to 0.91 in the greatest frame
of three real drags (cheese_tube of Parag, Incipient-Slip-Detection), 0.99 and more in
drawn ones, 0.00 where prints come or go (tests/pipeline/test_reference_messages.py). Set by hand between
them, on these clips."""


def most_likely_hyperparameters(
    grid: GelGrid,
    information_per_mm2: Float[np.ndarray, "n 3 3"],
    frames_mm: Sequence[Float[np.ndarray, "n 3"]] | Float[np.ndarray, "f n 3"],
) -> PriorHyperparameters:
    """The hyperparameters of greatest marginal likelihood over some loaded frames, by factors of two.

    The contact is found anew after every round of climbing. Where depth is not seen, contact and prior depend
    so much on each other that it is found anew at every step of one more climb. A contact found far too small
    makes noise of the gel's motion, which then shows no contact at all: where the gel is dragged one way, the
    noise of the round before it is taken. Else nothing presses, as where the reference bears a print.
    """
    solver = InvertedForce(grid, information_per_mm2, INITIAL_HYPERPARAMETERS)
    noises = list[float]()
    touching = [np.ones(len(grid.nodes_mm), dtype=bool) for _ in frames_mm]
    for _ in range(ROUNDS):
        pairs = [(y, contact) for y, contact in zip(frames_mm, touching, strict=True) if contact.any()]
        if not pairs:
            break
        solver = _climbed(
            solver,
            ORDER_OF_CLIMBING,
            lambda trial: sum(trial.log_evidence(y, contact) for y, contact in pairs),  # noqa: B023
        )
        noises.append(solver.hyperparameters.noise)
        touching = [solver.active_set(y).touching for y in frames_mm]
    if solver.sees_depth:
        return solver.hyperparameters
    for noise in reversed(noises):
        solver = _climbed(
            solver.with_prior(replace(INITIAL_HYPERPARAMETERS, noise=noise)),
            CLIMBED_WITH_CONTACT,
            lambda trial: sum(trial.active_set(y).log_likelihood for y in frames_mm),
        )
        touches = any(solver.active_set(y).touching.any() for y in frames_mm)
        if touches or max(map(one_way_share, frames_mm)) < DRAGGED:
            break
    return solver.hyperparameters


def one_way_share(displacement_mm: Float[np.ndarray, "n 3"]) -> float:
    """|sum |d| d| / sum |d|^2 along the face: 1 where all that moves goes one way, 0 round a press."""
    along = np.where(np.isfinite(displacement_mm).all(axis=1)[:, None], displacement_mm, 0.0)[:, :2]
    size = np.linalg.norm(along, axis=1)
    return float(np.linalg.norm(size @ along) / max(float(size @ size), 1e-300))


def _climbed(
    start: InvertedForce, order: Sequence[str], likelihood: Callable[[InvertedForce], float]
) -> InvertedForce:
    """The start with one hyperparameter after the other taken times two, or half, up to four times, while
    that makes it likelier; the noise never falls below that of frames in the air.
    """
    best, most = start, likelihood(start)
    for name in order:
        for factor in (2.0, 0.5):
            for _ in range(4):
                prior = best.hyperparameters
                tried = replace(prior, **{name: getattr(prior, name) * factor})
                if tried.noise < LEAST_NOISE:
                    break
                trial = best.with_prior(tried)
                if (value := likelihood(trial)) <= most:
                    break
                best, most = trial, value
    return best

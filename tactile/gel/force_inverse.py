"""Forces on a gel's face from its displacement: a linear inverse problem.

Unknowns are forces t on the nodes of a square grid (tents of traction, tactile.gel.slab). Data are marker
displacements y with information W: inverse covariance, zero along a direction that no camera observes. A
Gaussian prior has precision Q = (1 + roughness^2 Laplacian) / sd^2 on each component. In the contact

    L t = G' W y,    L = G' W G + Q,    covariance of t = L^-1

Outside t = 0; inside the pressure is positive. An active-set search starts from the unconstrained solution,
drops nodes that pull and adds neighbours that push. tactile.gel.normal_equations computes once what frames
share. G also has columns of smooth fields that no force causes: quadratics over the pad, a percent or two of
the displacement. They represent the effect of free sides and a housing. An almost incompressible gel is so
stiff under uniform pressure that 5 um of uniform depth are 5 % of a press of 3 N. The hyperparameters
maximise the marginal likelihood of loaded frames (tactile.gel.grid):

    2 log p = t' L t - y' W y - log det L + log det Q + log det W      (constants omitted; MacKay 1992)

They are the prior's standard deviations and roughness, and the noise over that of no-contact frames.
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
"""A node starts in contact if its unconstrained pressure exceeds this many standard deviations, or this share
of the greatest. Set by hand."""
GROWS_AT_SD = 1.0
"""A node adjacent to the contact joins it if its push exceeds this many standard deviations."""
APPEARS_AT_SD = 6.0
"""The same for other nodes: among hundreds of them, some would reach 4 by chance. Set by hand."""
MOST_ROUNDS = 40
"""Most rounds in which nodes may join; then they only leave, so that the search ends. Set by hand."""
OF_PEAK = (0.15, 0.4)
"""Without depth the search also starts from nodes with these shares of the greatest pressure. Set by hand."""
KEPT_VIEWS = 3
"""Sets of visible markers whose equations are cached, for frames that alternate. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Nodes in contact, the unknowns (0 outside), and each outer node's push in standard deviations.

    `log_likelihood`: ln marginal likelihood of the frame, up to a constant of the frame and its noise.
    """

    touching: Bool[np.ndarray, " m"]
    unknowns: Float[np.ndarray, " u"]
    push_sd: Float[np.ndarray, " m"]
    log_likelihood: float


@dataclass(frozen=True, kw_only=True)
class GelContact:
    """Solution of one frame: nodes in contact, and the markers' forces (N) and modelled displacement."""

    touching: Bool[np.ndarray, " m"]
    force_N: Float[np.ndarray, "n 3"]
    displacement_mm: Float[np.ndarray, "n 3"]


def sees_depth(information_per_mm2: Float[np.ndarray, "n 3 3"]) -> bool:
    """Whether the cameras observe three directions; the first marker shows it, as all share the cameras."""
    return bool(np.linalg.matrix_rank(information_per_mm2[0], hermitian=True, rtol=1e-6) == 3)


class InvertedForce:
    """Solver for the forces of one gel; it computes once what frames share.

    `information_per_mm2` (n, 3, 3): inverse covariance of marker displacement in one frame without contact.
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
        """The solver of the same gel and sensor with another prior of forces and another noise."""
        other = copy(self)
        other._take(hyperparameters)
        return other

    def solve(
        self,
        displacement_mm: Float[np.ndarray, "n 3"],
        *,
        before: Bool[np.ndarray, " m"] | None = None,
    ) -> GelContact:
        """The solution of one frame without NaN markers. `before`: nodes in contact in the frame before."""
        y, equations, right = self._observed(displacement_mm)
        active_set = self._solved_active_set(equations, right, motion_of(y), before)
        t = active_set.unknowns[: self._size].reshape(-1, 3)
        return GelContact(
            touching=active_set.touching,
            force_N=self.grid.to_markers @ t,
            displacement_mm=(self._moved_by @ active_set.unknowns).reshape(y.shape),
        )

    def active_set(self, displacement_mm: Float[np.ndarray, "n 3"]) -> ActiveSet:
        """The active set of one frame: no touching node pulls, and no outer one pushes beyond its limit."""
        y, equations, right = self._observed(displacement_mm)
        return self._solved_active_set(equations, right, motion_of(y))

    def log_evidence(
        self, displacement_mm: Float[np.ndarray, "n 3"], touching: Bool[np.ndarray, " m"]
    ) -> float:
        """ln marginal likelihood of a frame with a known contact, up to a constant of the sensor."""
        y, equations, right = self._observed(displacement_mm)
        smooth = smooth_precision(self.grid, motion_of(y))
        forces, fields, log_det_root = equations.factor(touching).solved(right, smooth)
        fitted = right[dofs_of(touching)] @ forces + right[self._size :] @ fields
        misfit = float(np.einsum("ni,nij,nj->", y, self.information, y))
        directions = (3 if self.sees_depth else 2) * int(np.isfinite(displacement_mm).all(axis=1).sum())
        log_det = log_det_prior(self.grid, self.hyperparameters, touching) / 2 - log_det_root
        return float((fitted - misfit) / 2 + log_det - directions * np.log(self.hyperparameters.noise))

    def _observed(self, displacement_mm: np.ndarray) -> tuple[np.ndarray, NormalEquations, np.ndarray]:
        """Displacement (0 if unknown), equations and right side of the visible markers."""
        usable = np.isfinite(displacement_mm).all(axis=1)
        y = np.where(usable[:, None], displacement_mm, 0.0)
        weighted = np.matmul(self.information, y[:, :, None]).ravel()
        return y, self._equations_of(usable), weighted @ self._moved_by

    def _equations_of(self, usable: Bool[np.ndarray, " n"]) -> NormalEquations:
        """The equations of the usable markers; those of the last few sets are cached."""
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
        """The active set. Without depth several sets satisfy its conditions, some with twice the true force.
        The search then starts from several sets and returns the most likely one.
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
        """The nodes with a neighbour in `nodes`."""
        return np.asarray(np.append(nodes, False)[self._adjacent_nodes].any(axis=1))

    def _first_touching(
        self, equations: NormalEquations, right: np.ndarray, motion_mm: float
    ) -> Bool[np.ndarray, " m"]:
        """Nodes that push in the unconstrained solution and would be detected alone, if any would be."""
        free = equations.free_pressures(right)
        single_node_sd = self._single_node_sd(equations, right, motion_mm)
        # Without depth the standard deviations are large: a share of the peak decides.
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
        """The active set reached from `touching`: nodes that pull leave and those that push join, until a set
        recurs; then nodes only leave.
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
    """Indices of each node's neighbours; rows with fewer are filled with the number of nodes."""
    most = int(adjacent.sum(axis=1).max())
    first = np.argsort(~adjacent, axis=1, kind="stable")[:, :most]
    return np.where(np.take_along_axis(adjacent, first, axis=1), first, len(adjacent))


ORDER_OF_CLIMBING = ("pressure_MPa", "shear_MPa", "noise", "roughness", "pressure_MPa", "shear_MPa", "noise")
"""Order in which the search varies the hyperparameters; it repeats the first ones, which depend on the
last."""
CLIMBED_WITH_CONTACT = ("roughness", "pressure_MPa", "shear_MPa", "roughness", "pressure_MPa", "shear_MPa")
"""The same for a search that determines the contact again at every step."""
ROUNDS = 2
"""Rounds of the search: with every node in contact, then with the contact of the first round. Set by hand."""
LEAST_NOISE = 0.99
"""Least noise over that of no-contact frames: 1, but for rounding."""
DRAGGED = 0.4
"""Share of one direction in the motion of a gel, above which it is dragged. Three real drags have 0.54 to
0.91 in their greatest frame (cheese_tube of Parag, Incipient-Slip-Detection), synthetic ones 0.99 and more.
Imprints that appear or vanish have 0.00 (tests/pipeline/test_raw_grasps.py). Set by hand between
them, on these clips."""


def most_likely_hyperparameters(
    grid: GelGrid,
    information_per_mm2: Float[np.ndarray, "n 3 3"],
    frames_mm: Sequence[Float[np.ndarray, "n 3"]] | Float[np.ndarray, "f n 3"],
) -> PriorHyperparameters:
    """The hyperparameters of greatest marginal likelihood over some loaded frames, in factors of two.

    Each round of the search ends with a new contact. Without depth, contact and prior depend strongly on each
    other, so one more search determines the contact at every step. A contact far too small attributes the
    gel's motion to noise, and the search then finds no contact. If the gel is dragged one way, the search
    restarts with the noise of the round before. Otherwise nothing presses, for example if the reference has
    an imprint.
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
    """|sum |d| d| / sum |d|^2 along the face: 1 if all motion has one direction, 0 around a press."""
    along = np.where(np.isfinite(displacement_mm).all(axis=1)[:, None], displacement_mm, 0.0)[:, :2]
    size = np.linalg.norm(along, axis=1)
    return float(np.linalg.norm(size @ along) / max(float(size @ size), 1e-300))


def _climbed(
    start: InvertedForce, order: Sequence[str], likelihood: Callable[[InvertedForce], float]
) -> InvertedForce:
    """The solver after varying each hyperparameter in `order`: doubled or halved up to four times while the
    likelihood grows. The noise stays at least that of no-contact frames.
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

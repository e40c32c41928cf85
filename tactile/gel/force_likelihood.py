"""The prior of forces on a gel's face, chosen by the data: greatest marginal likelihood of loaded frames.

    2 log p = t' L t - y' W y - log det L + log det Q + log det W      (constants left out; MacKay 1992)

in the notation of tactile.gel.force_inverse, over the prior's spread and roughness, and by how much the noise
exceeds what frames in the air show.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from tactile.gel.force_inverse import InvertedForce, sees_depth
from tactile.gel.grid import (
    INITIAL_HYPERPARAMETERS,
    GelGrid,
    PriorDeterminant,
    PriorHyperparameters,
    displacement_by,
    dofs_of,
    motion_of,
    prior_precision,
    smooth_precision,
)
from tactile.gel.normal_equations import TouchingFactor, factor_of

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
    *,
    observed: Float[np.ndarray, "3*n u"] | None = None,
) -> PriorHyperparameters:
    """The hyperparameters of greatest marginal likelihood over some loaded frames, by factors of two.

    The contact is found anew after every round of climbing. Where depth is not seen, contact and prior depend
    so much on each other that it is found anew at every step of one more climb. A contact found far too small
    makes noise of the gel's motion, which then shows no contact at all: where the gel is dragged one way, the
    noise of the round before it is taken. Else nothing presses, as where the reference bears a print.
    """
    best, noises = INITIAL_HYPERPARAMETERS, list[float]()
    seen = displacement_by(grid) if observed is None else observed
    for turn in range(ROUNDS):
        everywhere = np.ones(len(grid.nodes_mm), dtype=bool)
        touching = [everywhere for _ in frames_mm]
        if turn:
            solver = InvertedForce(grid, information_per_mm2, best, observed=seen)
            touching = [solver.solve(y).touching for y in frames_mm]
        pairs = [(y, c) for y, c in zip(frames_mm, touching, strict=True) if c.any()]
        if not pairs:
            break
        statistics = [_sufficient_statistics(seen, information_per_mm2, y, c) for y, c in pairs]
        best = _climbed(best, ORDER_OF_CLIMBING, partial(_evidence, grid, statistics))
        noises.append(best.noise)
    if not noises or sees_depth(information_per_mm2):
        return best
    for noise in reversed(noises):
        solver = InvertedForce(
            grid, information_per_mm2, replace(INITIAL_HYPERPARAMETERS, noise=noise), observed=seen
        )
        best = _with_contact(solver, frames_mm)
        touches = any(solver.with_prior(best).active_set(y).touching.any() for y in frames_mm)
        if touches or max(map(one_way_share, frames_mm)) < DRAGGED:
            break
    return best


def one_way_share(displacement_mm: Float[np.ndarray, "n 3"]) -> float:
    """|sum |d| d| / sum |d|^2 along the face: 1 where all that moves goes one way, 0 round a press."""
    along = np.where(np.isfinite(displacement_mm).all(axis=1)[:, None], displacement_mm, 0.0)[:, :2]
    size = np.linalg.norm(along, axis=1)
    return float(np.linalg.norm(size @ along) / max(float(size @ size), 1e-300))


def _with_contact(
    solver: InvertedForce, frames_mm: Sequence[Float[np.ndarray, "n 3"]] | Float[np.ndarray, "f n 3"]
) -> PriorHyperparameters:
    """The climb from the solver's prior, noise as it is, with the contact of every trial."""

    def likelihood(trial: PriorHyperparameters) -> float:
        tried = solver.with_prior(trial)
        return sum(tried.active_set(y).log_likelihood for y in frames_mm)

    return _climbed(solver.hyperparameters, CLIMBED_WITH_CONTACT, likelihood)


def _climbed(
    start: PriorHyperparameters, order: Sequence[str], likelihood: Callable[[PriorHyperparameters], float]
) -> PriorHyperparameters:
    """The start with one hyperparameter after the other taken times two, or half, up to four times, while
    that makes it likelier; the noise never falls below that of frames in the air.
    """
    best, most = start, likelihood(start)
    for name in order:
        for factor in (2.0, 0.5):
            for _ in range(4):
                trial = replace(best, **{name: getattr(best, name) * factor})
                if trial.noise < LEAST_NOISE or (value := likelihood(trial)) <= most:
                    break
                best, most = trial, value
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
    at = np.concatenate([dofs_of(touching), np.arange(3 * len(touching), seen.shape[1])])
    G = seen[:, at].reshape(len(y), 3, -1)[usable]
    W = information[usable]
    weighted, flat = np.matmul(W, G).reshape(-1, G.shape[2]), G.reshape(-1, G.shape[2])
    return SufficientStatistics(
        touching=touching,
        normal=weighted.T @ flat,
        right=weighted.T @ y[usable].ravel(),
        misfit=float(np.einsum("ni,nij,nj->", y[usable], W, y[usable])),
        directions=int(np.linalg.matrix_rank(information[0], hermitian=True, rtol=1e-6)) * int(usable.sum()),
        motion_mm=motion_of(np.where(usable[:, None], y, 0.0)),
    )


def _evidence(
    grid: GelGrid, statistics: Sequence[SufficientStatistics], hyperparameters: PriorHyperparameters
) -> float:
    """Log marginal likelihood of frames whose contacts are known, up to a constant of the sensor.

    Frames of one contact and the same markers in view share the factor of their forces' block.
    """
    total = 0.0
    prior, log_det_prior = prior_precision(grid, hyperparameters), PriorDeterminant(grid, hyperparameters)
    factor: TouchingFactor | None = None
    of_prior = 0.0
    for k, frame in enumerate(statistics):
        before = statistics[k - 1]
        if factor is None or not (
            np.array_equal(frame.touching, before.touching) and np.array_equal(frame.normal, before.normal)
        ):
            normal = frame.normal / hyperparameters.noise**2
            at = dofs_of(frame.touching)
            normal[: len(at), : len(at)] += prior[np.ix_(at, at)]
            factor, of_prior = factor_of(normal, len(at)), log_det_prior(np.flatnonzero(frame.touching))
        right = frame.right / hyperparameters.noise**2
        forces, fields, log_det_root = factor.solved(right, smooth_precision(grid, frame.motion_mm))
        fitted = right[: len(forces)] @ forces + right[len(forces) :] @ fields
        total += float(
            0.5 * (fitted - frame.misfit / hyperparameters.noise**2 + of_prior)
            - log_det_root
            - frame.directions * np.log(hyperparameters.noise)
        )
    return total

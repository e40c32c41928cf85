"""The prior of forces on a gel's face, chosen by the data: greatest marginal likelihood of loaded frames.

    2 log p = t' L t - y' W y - log det L + log det Q + log det W      (constants left out; MacKay 1992)

in the notation of tactile.gel.force_inverse, over the prior's spread and roughness, and by how much the noise
exceeds what frames in the air show.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactile.gel.force_inverse import InvertedForce
from tactile.gel.grid import INITIAL_HYPERPARAMETERS, GelGrid, PriorHyperparameters

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

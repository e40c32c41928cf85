"""One modulus per fruit, from several grasps of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fem.modulus import ModulusEstimate


@dataclass(frozen=True, kw_only=True)
class FruitModulus:
    """`E_MPa` of the fruit; `between_sd_MPa` is the scatter of grasps beyond their own errors."""

    E_MPa: float
    E_sd_MPa: float
    between_sd_MPa: float
    grasps: int
    warnings: tuple[str, ...]


def combine_grasps(estimates: Sequence[ModulusEstimate]) -> FruitModulus:
    """The mean weighted by inverse variance, in ln E, with a random effect per grasp.

    Each grasp has its own noise (sensor, scale errors) and half of the model's variance (the part of mesh and
    pit error that depends on where it was pressed); the scatter between grasps beyond that is estimated after
    DerSimonian and Laird (1986). The other half of the model's variance is common to all grasps and is added
    to the mean's. Raises ValueError without an estimate.
    """
    if not estimates:
        raise ValueError("combine_grasps needs at least one estimate, found none")
    log = np.log([estimate.E_MPa for estimate in estimates])
    model = np.array([estimate.model_sd_MPa / estimate.E_MPa for estimate in estimates])
    noise = np.array([estimate.least_squares.own_sd_MPa / estimate.E_MPa for estimate in estimates])
    own = noise**2 + LOCAL_SHARE * model**2
    between = _between(log, own)
    weight = 1 / (own + between)
    mean = float(weight @ log / weight.sum())
    variance = 1 / weight.sum() + (1 - LOCAL_SHARE) * float(np.average(model**2, weights=weight))
    modulus = float(np.exp(mean))
    found = []
    if between > 0 and np.sqrt(between) > SCATTER:
        each = ", ".join(f"{estimate.E_MPa:.3f}" for estimate in estimates)
        found.append(f"grasps of this fruit disagree beyond their errors ({each} MPa)")
    return FruitModulus(
        E_MPa=modulus,
        E_sd_MPa=modulus * float(np.sqrt(variance)),
        between_sd_MPa=modulus * float(np.sqrt(between)),
        grasps=len(estimates),
        warnings=tuple(found),
    )


LOCAL_SHARE = 0.5
"""Share of the model's variance that is a grasp's own."""
SCATTER = 0.03
"""Relative scatter between grasps, beyond their errors, that is worth a sentence."""


def _between(log: np.ndarray, own: np.ndarray) -> float:
    """Variance of the random effect, zero or above."""
    if len(log) < 2:
        return 0.0
    weight = 1 / own
    excess = float(weight @ (log - np.average(log, weights=weight)) ** 2) - (len(log) - 1)
    return max(0.0, excess / float(weight.sum() - (weight**2).sum() / weight.sum()))

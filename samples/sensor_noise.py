"""What a marker sensor adds to the truth; the figures are assumed, for a calibrated marker gel."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Per component: noise of a frame (AR(1)), of the reference frame; per marker: scale errors; steps."""

    displacement_mm: float = 0.004
    reference_mm: float = 0.002
    force_N: float = 0.005
    reference_N: float = 0.0026
    displacement_scale: float = 0.004
    force_scale: float = 0.01
    correlation: float = 0.3
    displacement_step_mm: float = 2.0**-13
    force_step_N: float = 2.0**-13


def measured(
    displacement_mm: Float[np.ndarray, "t n 3"],
    force_N: Float[np.ndarray, "t n 3"],
    noise: SensorNoise,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "t n 3"], Float[np.ndarray, "t n 3"]]:
    """True marker displacement and force as the sensor would give them, rounded to its steps."""
    return (
        _sensed(
            displacement_mm, noise.displacement_mm, noise.reference_mm, noise.displacement_scale,
            noise.displacement_step_mm, noise.correlation, rng,
        ),
        _sensed(
            force_N, noise.force_N, noise.reference_N, noise.force_scale,
            noise.force_step_N, noise.correlation, rng,
        ),
    )  # fmt: skip


def _sensed(
    truth: np.ndarray, sd: float, reference_sd: float, scale: float, step: float, lag1: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "t n 3"]:  # fmt: skip
    frames, markers, _ = truth.shape
    gain = 1.0 + scale * rng.normal(size=(markers, 1))
    coloured = rng.normal(size=truth.shape)
    for t in range(1, frames):
        coloured[t] = lag1 * coloured[t - 1] + np.sqrt(1 - lag1**2) * coloured[t]
    reference = rng.normal(size=(markers, 3))
    return np.asarray(np.rint((gain * truth + sd * coloured + reference_sd * reference) / step) * step)

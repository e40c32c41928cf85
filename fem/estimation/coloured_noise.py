"""Coloured noise: variance of its mean over that of white noise, and random draws."""

import numpy as np
from jaxtyping import Float


def variance_inflation(lag1: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The variance of a mean over many frames, over that of white noise with the same standard deviation.

    (1 + r) / (1 - r) for first-order autoregressive noise whose neighbouring frames correlate by r = `lag1`,
    below one: 1 + 2 (r + r^2 + ...), all lags counted (Bartlett 1946). It multiplies the variance; a standard
    deviation takes its root. Sums with weights that change slowly from frame to frame behave like the mean;
    the noise of a single frame is not inflated.

    >>> float(variance_inflation(np.array([0.5]))[0])
    3.0
    """
    return np.asarray((1 + lag1) / (1 - lag1))


def drawn_coloured_noise(
    shape: tuple[int, ...], lag1: float, rng: np.random.Generator
) -> Float[np.ndarray, "p f n 3"]:
    """First-order autoregressive noise of unit variance along the second axis."""
    drawn = rng.normal(size=shape)
    for k in range(1, shape[1]):
        drawn[:, k] = lag1 * drawn[:, k - 1] + np.sqrt(1 - lag1**2) * drawn[:, k]
    return drawn

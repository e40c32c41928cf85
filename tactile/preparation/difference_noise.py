"""Noise and usual steps of a record, by robust statistics of its differences."""

import numpy as np
from jaxtyping import Float

THIRD, MAD = 20.0, 1.4826
"""Variance of the third difference of unit white noise, and a normal's sd over its median deviation."""
LEAST_SHARE = 1e-6
"""Noise is at least this share of the range: values in double precision have less."""


def noise_sd(values: Float[np.ndarray, " t"]) -> float:
    """Standard deviation of white noise, from third differences: a smooth course leaves next to nothing, and
    their median is blind to a few jumps. At least that of rounding to the smallest step of the values.

    >>> noise = np.random.default_rng(0).normal(scale=0.1, size=10_000)
    >>> round(noise_sd(np.linspace(0, 50, 10_000) + noise), 2)
    0.1
    """
    if len(values) < 4:
        return 1e-12
    third = MAD * float(np.median(np.abs(np.diff(values, 3)))) / THIRD**0.5
    return float(max(third, resolution(values) / 12**0.5, LEAST_SHARE * middle_range(values), 1e-12))


def resolution(values: Float[np.ndarray, " t"]) -> float:
    """The least difference between two different values; 0 where all are equal.

    >>> resolution(np.array([0.0, 0.5, 0.75, 0.75]))
    0.25
    """
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-9 * max(float(np.abs(values).max(initial=0.0)), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0


def middle_range(values: Float[np.ndarray, " t"]) -> float:
    """From the 2nd to the 98th percentile: a few wild values do not change it."""
    low, high = np.percentile(values, [2, 98])
    return float(high - low)

"""A field that lags behind another: the internal variable of one relaxing arm."""

import numpy as np
from jaxtyping import Float


def lagging(
    values: Float[np.ndarray, "t n 3"], time_s: Float[np.ndarray, " t"], retardation_s: float
) -> Float[np.ndarray, "t n 3"]:
    """h with h' = (c - h) / retardation, exact where c runs straight between frames; at first h = c."""
    lag = np.empty_like(values)
    lag[0] = values[0]
    for k in range(1, len(values)):
        x = (time_s[k] - time_s[k - 1]) / retardation_s
        fade, mean = np.exp(-x), -np.expm1(-x) / x
        lag[k] = fade * lag[k - 1] + (mean - fade) * values[k - 1] + (1 - mean) * values[k]
    return lag

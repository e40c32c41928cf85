"""`viscoelastic`: the flesh relaxes.  E(t) = E (1 - g + g exp(-t / tau))

With Poisson's ratio constant every displacement under given forces is the elastic one, crept (correspondence
principle; Christensen 1982, Theory of Viscoelasticity, chapter 2): for one arm

    u(t) = s [c(t) + g / (1 - g) (c(t) - h(t))],      h' = (c - h) (1 - g) / tau

h lags behind c with the retardation time tau / (1 - g). Signature: the same for g -> 0.
"""

import numpy as np
from jaxtyping import Float


def lagging(
    values: Float[np.ndarray, "t n 3"], time_s: Float[np.ndarray, " t"], retardation_s: float
) -> Float[np.ndarray, "t n 3"]:
    """h with h' = (c - h) / retardation, exact where c runs in straight lines between frames; h = c at first."""
    lag = np.empty_like(values)
    lag[0] = values[0]
    for k in range(1, len(values)):
        x = (time_s[k] - time_s[k - 1]) / retardation_s
        fade = np.exp(-x)
        mean = -np.expm1(-x) / x
        lag[k] = fade * lag[k - 1] + (mean - fade) * values[k - 1] + (1 - mean) * values[k]
    return lag

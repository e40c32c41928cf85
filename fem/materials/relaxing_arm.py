"""Flesh that relaxes by one arm,  E(t) = E (1 - g + g exp(-t / tau)),  as what it creeps.

With Poisson's ratio constant every displacement under given forces is the elastic one, c, crept
(correspondence principle; Christensen, "Theory of Viscoelasticity", 1982, chapter 2):

    c(t) + g / (1 - g) h(t),      h' = (c - h) (1 - g) / tau
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class RelaxingArm:
    """The share g of the resistance that fades, and the time over which it does."""

    g: float
    tau_s: float

    @classmethod
    def of_creep(cls, share: float, retardation_s: float) -> "RelaxingArm":
        """From the share of c that is crept at last, and the time over which it is.

        >>> RelaxingArm.of_creep(0.25, 5.0)
        RelaxingArm(g=0.2, tau_s=4.0)
        """
        g = share / (1 + share)
        return cls(g=g, tau_s=retardation_s * (1 - g))

    @property
    def creep_share(self) -> float:
        """g / (1 - g)."""
        return self.g / (1 - self.g)

    @property
    def retardation_s(self) -> float:
        """tau / (1 - g): creep is slower than relaxation."""
        return self.tau_s / (1 - self.g)


def lagging(
    values: Float[np.ndarray, "t ..."],
    time_s: Float[np.ndarray, " t"],
    retardation_s: float | Float[np.ndarray, "..."],
) -> Float[np.ndarray, "t ..."]:
    """h with h' = (c - h) / retardation, exact where c runs straight between frames; at first h = c.

    A retardation time for all values, or each its own.

    After one retardation time 63 % of a step has been followed.

    >>> lagging(np.array([0.0, 1, 1]), np.array([0.0, 1e-9, 1.0]), 1.0).round(3)
    array([0.   , 0.   , 0.632])
    """
    lag = np.empty_like(values)
    lag[0] = values[0]
    for k in range(1, len(values)):
        x = (time_s[k] - time_s[k - 1]) / retardation_s
        fade, mean = np.exp(-x), -np.expm1(-x) / x
        lag[k] = fade * lag[k - 1] + (mean - fade) * values[k - 1] + (1 - mean) * values[k]
    return lag

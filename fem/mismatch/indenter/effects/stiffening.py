"""Flesh that grows stiffer the more energy it holds: Fung's exponential."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from fem.mismatch.indenter.effects.effect import Effect
from fem.mismatch.indenter.energy_share import energy_classes, force_share
from fem.mismatch.indenter.unknowns import Unknown

NAME = "stiffening"
EFFECT = Effect(
    name=NAME, unknowns=(Unknown(name="b", unit="1", scale="log", mean=float(np.log(3.0)), sd=1.2),)
)
#: largest b depth/R, where the field's own change has long made the estimate useless
LARGEST = 100.0


def stiffening_share(
    b: Float[np.ndarray, "p 1"], strain: Float[np.ndarray, "p n"]
) -> Float[np.ndarray, "p n"]:
    """Force over the linear one where stress is exp(b W/mu) times linear; strain = depth/R = (a/R)^2.

    Stored energy mu/b (exp(b W/mu) - 1), W spread as under Hertz. Source: Fung, "Elasticity of soft tissues
    in simple elongation", Am. J. Physiol. 213, 1967; its spreading: energy_share.
    """
    return np.asarray(np.exp(_log_share()(np.minimum(b * strain, LARGEST))))


@lru_cache(maxsize=1)
def _log_share() -> CubicSpline:
    """Logarithm of the share over s = b depth/R, which is all that it depends on."""
    w, volume = energy_classes()
    s = LARGEST * np.linspace(0, 1, 200)[1:] ** 2
    grown = s[:, None] * w
    share = force_share(np.expm1(grown) / s[:, None], w * np.exp(grown), volume)
    return CubicSpline(np.r_[0, s], np.r_[0, np.log(share)])

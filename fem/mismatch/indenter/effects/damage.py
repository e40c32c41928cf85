"""Flesh softened for good where it was strained most: Mullins damage."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from fem.mismatch.indenter.effects.effect import Effect
from fem.mismatch.indenter.energy_share import energy_classes, force_share
from fem.mismatch.indenter.unknowns import Unknown

NAME = "damage"
#: k = mu depth/(R W0) that the table reaches: from no damage at all to all of dmax
REACH = (1e-4, 1e6)
EFFECT = Effect(
    name=NAME,
    unknowns=(
        Unknown(name="dmax", unit="1", scale="logit", mean=-0.4, sd=1.0),
        Unknown(name="W0_over_E", unit="1", scale="log", mean=float(np.log(0.02)), sd=1.3),
    ),
)


def damage_share(
    dmax: Float[np.ndarray, "p 1"],
    W0_over_E: Float[np.ndarray, "p 1"],
    deepest_strain: Float[np.ndarray, "p t"],
    *,
    poisson_ratio: float,
) -> Float[np.ndarray, "p t"]:
    """Force left of the undamaged one after the ball has been `deepest_strain` = depth/R deep.

    Stress times 1 - dmax (1 - exp(-Wmax/W0)). While loading, the force is that of the energy density
    W - dmax (W - W0 (1 - exp(-W/W0))), spread as under Hertz; drawn back, the share stays what it was at the
    deepest point (a ball that touches less then feels the worst damaged flesh alone: not modelled).
    Source: Simo, "On a fully three-dimensional finite-strain viscoelastic damage model", Comput. Methods
    Appl. Mech. Engrg. 60, 1987 (discontinuous damage driven by the largest energy).
    """
    k = deepest_strain / (2 * (1 + poisson_ratio) * W0_over_E)
    return np.asarray(1 - dmax * _lost_share()(np.log(np.clip(k, *REACH))))


@lru_cache(maxsize=1)
def _lost_share() -> CubicSpline:
    """Share of the force lost, per dmax, over the logarithm of k = mu depth/(R W0)."""
    w, volume = energy_classes()
    log_k = np.linspace(np.log(REACH[0]), np.log(REACH[1]), 200)
    k = np.exp(log_k)[:, None]
    return CubicSpline(log_k, force_share(w + np.expm1(-k * w) / k, -w * np.expm1(-k * w), volume))

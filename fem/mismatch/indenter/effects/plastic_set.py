"""Flesh that yields and keeps a dent."""

import numpy as np
from jaxtyping import Float

from fem.mismatch.indenter.effects.effect import Effect
from fem.mismatch.indenter.unknowns import Unknown

NAME = "plastic_set"
EFFECT = Effect(
    name=NAME,
    unknowns=(Unknown(name="yield_over_E", unit="1", scale="log", mean=float(np.log(0.08)), sd=1.0),),
)
#: mean pressure of fully plastic indentation over the yield stress
HARDNESS = 3.0


def plastic_slack_mm(
    yield_over_E: Float[np.ndarray, "p 1"],
    deepest_mm: Float[np.ndarray, "p t"],
    level_mm: Float[np.ndarray, "p n"],
    *,
    poisson_ratio: float,
    radius_mm: float,
) -> Float[np.ndarray, "p t n"]:
    """How far each spring has set: what it was pressed beyond the pressure that flesh can carry.

    Pressure is bounded by 3 Y. A constant pressure P over a contact of radius a is a row of springs with
    line load 2 P sqrt(a^2 - x^2); a spring carries E* per length, so its compression is bounded by
    6 Y/E* sqrt(a^2 - x^2), and with a^2 = R d, x^2 = R y by k sqrt(m), m = d - y, k = 6 Y/E* sqrt(R). What m
    exceeds it at the deepest point is the set. Yield starts at E* a/R = 6 Y, where Hertz's largest pressure
    is 3.8 Y (true: 1.6 Y under the skin, 2.8-3 Y once fully plastic).
    Source: Johnson, "Contact Mechanics", 1985, sec. 6.2-6.3 (hardness, onset).
    """
    over = np.maximum(deepest_mm[:, :, None] - level_mm[:, None], 0.0)
    k = 2 * HARDNESS * (1 - poisson_ratio**2) * np.sqrt(radius_mm) * yield_over_E
    return np.asarray(np.maximum(over - k[..., None] * np.sqrt(over), 0.0))

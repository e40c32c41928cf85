"""Flesh that grows stiffer the more energy it holds: Fung's exponential."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.energy_share import energy_classes, force_share
from fem.indentation.trace_effect import TraceEffect, TraceEffectSpec, Values, unknown
from fem.mismatch.effects.stiffening import SPEC

#: power that tells how the field escapes stiffened flesh by spreading, measured with finite elements
ESCAPE = 0.19
#: largest b depth/R of the table
LARGEST = 100.0


def stiffening_share(
    b: Float[np.ndarray, "p 1"], strain: Float[np.ndarray, "p n"], *, poisson_ratio: float
) -> Float[np.ndarray, "p n"]:
    """Force over the linear one where stress is exp(b W/mu) times linear; strain = (a/R)^2 = depth/R
    on a half-space, ContactCurve.energy_strain in general.

    In Hertz's strains the stored energy mu/b (exp(b W/mu) - 1) gives 1 + e, an upper bound; the true field
    spreads from where flesh stiffens: (1 + e/0.19)^0.19 follows finite elements (the tests say how closely).
    Source: Fung, "Elasticity of soft tissues in simple elongation", Am. J. Physiol. 213, 1967; its spreading:
    energy_share.
    """
    return np.asarray(np.exp(_log_share(poisson_ratio)(np.minimum(b * strain, LARGEST))))


@lru_cache(maxsize=8)
def _log_share(poisson_ratio: float) -> CubicSpline:
    """Logarithm of the share over s = b depth/R, which is all that it depends on."""
    w, _ = energy_classes(poisson_ratio)
    s = LARGEST * np.linspace(0, 1, 200)[1:] ** 2
    grown = s[:, None] * w
    excess = force_share(np.expm1(grown) / s[:, None], w * np.exp(grown), poisson_ratio=poisson_ratio) - 1
    return CubicSpline(np.r_[0, s], np.r_[0, ESCAPE * np.log1p(excess / ESCAPE)])


def _factor(
    value: Values, curve: ContactCurve, level_mm: Float[np.ndarray, "p n"]
) -> Float[np.ndarray, "p n"]:
    b, strain = value["b"][:, None], curve.energy_strain(level_mm)
    if curve.field == "uniform":  # nowhere to escape to: the law itself
        return np.asarray(np.exp(np.minimum(b * strain, LARGEST)))
    return stiffening_share(b, strain, poisson_ratio=curve.poisson_ratio)


STIFFENING = TraceEffect(
    name=SPEC.name,
    unknowns=(unknown(SPEC, "b", scale="log", mean=float(np.log(3.0)), sd=1.2),),
    stress_factor=_factor,
)
"""Prior: b of 3 within a factor of 3.3 (set by hand)."""
EFFECT = TraceEffectSpec(spec=SPEC, rank=20, forms=lambda _: (STIFFENING,))
"""Its place in the search: see TraceEffectSpec."""

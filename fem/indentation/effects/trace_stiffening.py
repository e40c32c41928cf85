"""Flesh that stiffens beyond the plain law: Fung's exponential under a ball, and in a uniform field also
rubber laws beyond neo-Hooke.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.energy_share import force_share, half_space, hertz_energy_density
from fem.indentation.trace_effect import TraceEffect, Unknown, Values, unknown
from fem.mismatch.effects.stiffening import SPEC

#: exponent by which the field spreads away from stiffened flesh, fitted to finite elements
ESCAPE = 0.19
#: largest b depth/R of the table
LARGEST = 100.0
#: least height over the initial height at which the rubber laws are evaluated
FLATTEST = 0.1


def fung_share(
    value: Values, curve: ContactCurve, level_mm: Float[np.ndarray, "p n"]
) -> Float[np.ndarray, "p n"]:
    """Force over the linear force if stress is exp(b W/mu) times the linear stress.

    In Hertz's strains the stored energy mu/b (exp(b W/mu) - 1) gives 1 + e, an upper bound. The true field
    spreads away from stiffened flesh: (1 + e/0.19)^0.19 agrees with finite elements (the tests state the
    accuracy). A uniform field cannot spread: there the law itself applies.
    Source: Fung, "Elasticity of soft tissues in simple elongation", Am. J. Physiol. 213, 1967; its spreading:
    energy_share.
    """
    grown = np.minimum(value["b"][:, None] * curve.energy_strain(level_mm), LARGEST)
    return np.asarray(np.exp(grown if curve.field == "uniform" else _log_share(curve.poisson_ratio)(grown)))


@lru_cache(maxsize=8)
def _log_share(poisson_ratio: float) -> CubicSpline:
    """Logarithm of the share as a function of s = b depth/R, its only variable."""
    r, z, _ = half_space()
    w = hertz_energy_density(r, z, poisson_ratio=poisson_ratio)
    s = LARGEST * np.linspace(0, 1, 200)[1:] ** 2
    grown = s[:, None] * w
    share = force_share(np.expm1(grown) / s[:, None], w * np.exp(grown), poisson_ratio=poisson_ratio)
    return CubicSpline(np.r_[0, s], np.r_[0, ESCAPE * np.log1p((share - 1) / ESCAPE)])


def yeoh_share(
    second: Float[np.ndarray, "p 1"], third: Float[np.ndarray, "p 1"], stretch: Float[np.ndarray, "p n"]
) -> np.ndarray:
    """P/P_nH of W = C1 x + C2 x^2 + C3 x^3, x = I1 - 3; `second`, `third` are C2/C1 and C3/C1.

    Source: Yeoh, "Some forms of the strain energy function for rubber", Rubber Chem. Technol. 66, 1993.
    """
    x = stretch**2 + 2 / stretch - 3
    return np.asarray(1 + 2 * second * x + 3 * third * x**2)


def ogden_share(power: Float[np.ndarray, "p 1"], stretch: Float[np.ndarray, "p n"]) -> np.ndarray:
    """P/P_nH of W = 2 mu/a^2 (l1^a + l2^a + l3^a - 3): 2/a (l^(a-1) - l^(-a/2-1))/(l - l^-2); 1 at a = 2.

    Source: Ogden, "Large deformation isotropic elasticity", Proc. R. Soc. A 326, 1972.
    """
    log = np.log(np.minimum(stretch, 1 - 1e-6))
    # l^(a-1) - l^(-a/2-1) = 2 l^(a/4-1) sinh(3/4 a ln l), which keeps its limit at a = 0
    sinh = np.where(
        np.abs(power) > 1e-6, np.sinh(0.75 * power * log) / np.where(power, power, 1.0), 0.75 * log
    )
    return np.asarray(4 * np.exp((power / 4 - 1) * log) * sinh / (np.exp(log) - np.exp(-2 * log)))


def two_ogden_share(
    power: Float[np.ndarray, "p 1"],
    power_2: Float[np.ndarray, "p 1"],
    weight_2: Float[np.ndarray, "p 1"],
    stretch: Float[np.ndarray, "p n"],
) -> np.ndarray:
    """Ogden's law of two terms, `weight_2`: the second's share of the modulus; Mooney-Rivlin at 2 and -2."""
    first, second = ogden_share(power, stretch), ogden_share(power_2, stretch)
    return np.asarray((1 - weight_2) * first + weight_2 * second)


def _linear(name: str, sd: float, mean: float = 0.0) -> Unknown:
    return Unknown(name=name, unit="1", scale="linear", mean=mean, sd=sd)


def _rubber(share: Callable[..., np.ndarray], *unknowns: Unknown) -> TraceEffect:
    """A law given by its share of the neo-Hookean force. The share is kept positive, since the search tries
    parameters far off their range.
    """

    def factor(value: Values, curve: ContactCurve, level_mm: np.ndarray) -> Float[np.ndarray, "p n"]:
        stretch = np.maximum(1 - level_mm / curve.length_mm, FLATTEST)
        return np.asarray(np.maximum(share(*(value[u.name][:, None] for u in unknowns), stretch), 1e-3))

    return TraceEffect(name=SPEC.name, unknowns=unknowns, stress_factor=factor)


FUNG = TraceEffect(
    name=SPEC.name,
    unknowns=(unknown(SPEC, "b", scale="log", mean=float(np.log(3.0)), sd=1.2),),
    stress_factor=fung_share,
)
"""Prior: b of 3 within a factor of 3.3 (set by hand)."""
RUBBER = (
    _rubber(yeoh_share, _linear("yeoh_second", 0.2), _linear("yeoh_third", 0.05)),
    _rubber(ogden_share, _linear("ogden_power", 4.0, 2.0)),
    _rubber(
        two_ogden_share,
        _linear("ogden_power", 4.0, 2.0),
        _linear("ogden_power_2", 4.0, -2.0),
        Unknown(name="ogden_weight_2", unit="1", scale="logit", mean=0.0, sd=1.7),
    ),
)
"""Laws of Yeoh and of Ogden (one term, two terms), for a uniform field. Priors (set by hand):
about neo-Hooke, wide enough for least-squares fits of silicone cylinders."""

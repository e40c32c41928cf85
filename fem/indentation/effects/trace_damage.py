"""Permanent softening of flesh where it was strained most: Mullins damage."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import InterpolatedUnivariateSpline, RectBivariateSpline

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.energy_share import half_space, hertz_energy_density
from fem.indentation.trace_effect import TraceEffect, Values, unknown
from fem.mismatch.effects.damage import SPEC

#: range of the table in ln k, k = mu depth/(R W0): from no damage to all of dmax
REACH = (-9.0, 12.0)
#: power by which softened flesh gains strain energy, fitted to finite elements, and its fixed-point rounds
FEEDBACK, ROUNDS = 2.7, 5
#: least contact radius of the table, over the largest contact radius
LEAST = 0.05


def damage_share(
    value: Values,
    curve: ContactCurve,
    depth_mm: Float[np.ndarray, "p t"],
    deepest_mm: Float[np.ndarray, "p t"],
) -> Float[np.ndarray, "p t"]:
    """Force over the undamaged force, at a depth after the deepest.

    The stress is multiplied by 1 - dmax (1 - exp(-Wmax/W0)), Wmax: Hertz's energy density at the deepest
    depth. The force is the work of that stress in Hertz's strains at the present depth: during retraction
    only the most damaged flesh carries the ball. Damaged flesh strains more: energies grow by the force share
    to the power -2.7, fitted to finite elements (the tests state the accuracy). In a uniform field all flesh
    is damaged equally, and the plates prescribe its strain.
    Source: Simo, "On a fully three-dimensional finite-strain viscoelastic damage model", Comput. Methods
    Appl. Mech. Engrg. 60, 1987 (discontinuous damage driven by the largest energy).
    """
    dmax = value["dmax"][:, None]
    k = curve.energy_strain(deepest_mm) / (2 * (1 + curve.poisson_ratio) * value["W0_over_E"][:, None])
    if curve.field == "uniform":
        return np.asarray(1 + dmax * np.expm1(-k))
    table, widest = _lost_share(curve.poisson_ratio)
    log_k, lost = np.log(k), np.zeros_like(k)
    for _ in range(ROUNDS):
        raised = np.clip(log_k - FEEDBACK * np.log1p(-lost), REACH[0], REACH[1])
        lost = dmax * widest(raised)
    width = np.sqrt(np.clip(depth_mm / deepest_mm, LEAST**2, 1.0))
    return np.asarray(1 - dmax * table.ev(raised, width))


@lru_cache(maxsize=8)
def _lost_share(poisson_ratio: float) -> tuple[RectBivariateSpline, InterpolatedUnivariateSpline]:
    """Lost share of the force, per dmax, as a function of log k and of the contact radius a over the largest
    one; and of log k alone at the largest contact.

    F = R/(2 a) int (1 - D) dW/da dV with W = mu (a/R)^2 w(x/a); dW/da by finite differences.
    """
    r, z, volume = half_space()
    log_k, width = np.linspace(REACH[0], REACH[1], 64), np.linspace(LEAST, 1, 20)
    lost = np.empty((len(log_k), len(width)))

    def density(a: float) -> Float[np.ndarray, " x"]:
        return a**2 * hertz_energy_density(r / a, z / a, poisson_ratio=poisson_ratio)

    growth = (density(1 + 1e-3) - density(1 - 1e-3)) / 2e-3 * volume
    for j, a in enumerate(width):
        worst = density(1 / a) * a**2
        lost[:, j] = -np.expm1(-np.exp(log_k)[:, None] * worst) @ growth / growth.sum()
    return RectBivariateSpline(log_k, width, lost), InterpolatedUnivariateSpline(log_k, lost[:, -1])


DAMAGE = TraceEffect(
    name=SPEC.name,
    unknowns=(
        unknown(SPEC, "dmax", scale="logit", mean=-0.4, sd=1.0),
        unknown(SPEC, "W0_over_E", scale="log", mean=float(np.log(0.02)), sd=1.3),
    ),
    force_factor=damage_share,
)
"""Priors on these scales: dmax 0.4 (0.2 to 0.65), W0/E 0.02 within a factor of 3.7 (set by hand). The error
of this reduced law is 0.3 % of the largest force (tests/fem/test_rubber_laws.py)."""

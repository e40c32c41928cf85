"""Closed forms: references for the finite elements, and textbook formulas for the modulus of fruit.

All moduli in MPa, lengths in mm, forces in N. nu is Poisson's ratio.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipkm1


def hertz_sphere_force_N(
    *, E_MPa: float, poisson_ratio: float, radius_mm: float, indentation_mm: float
) -> float:
    """Force that presses an elastic sphere on a rigid plane, or a rigid sphere into an elastic half-space.

    F = 4/3 E/(1 - nu^2) R^(1/2) d^(3/2).  Source: Johnson, "Contact Mechanics", 1985, eq. 4.23.

    >>> round(hertz_sphere_force_N(E_MPa=0.9, poisson_ratio=0.5, radius_mm=25, indentation_mm=1), 6)
    8.0
    """
    plane_strain_MPa = E_MPa / (1 - poisson_ratio**2)
    return float(4 / 3 * plane_strain_MPa * np.sqrt(radius_mm) * indentation_mm**1.5)


def contact_shape_factor(*, radius_mm: float, other_radius_mm: float) -> float:
    """K of ASABE S368 for a body with two principal radii on a plate; 1.350 for a sphere (tabulated: 1.351).

    The standard tabulates K over cos theta = |1/R - 1/R'| / (1/R + 1/R'); here it follows from the elliptic
    integrals behind that table (Johnson 1985, eqs. 4.25-4.32). With e the eccentricity of the ellipse and
    k = b/a: (1/R') / (1/R) = (E(e)/k^2 - K(e)) / (K(e) - E(e)) gives k, and the approach
    d = (9 F^2 / (16 E*^2 Re))^(1/3) F2(k), set equal to the standard's formula, gives K.

    >>> round(contact_shape_factor(radius_mm=30, other_radius_mm=30), 3)
    1.35
    """
    flat, steep = 1 / max(radius_mm, other_radius_mm), 1 / min(radius_mm, other_radius_mm)

    def excess(ratio: float) -> float:
        big, small = ellipkm1(ratio**2), ellipe(1 - ratio**2)
        return float((small / ratio**2 - big) / (big - small)) - steep / flat

    if steep / flat < 1 + 1e-5:
        factor = 1.0
    else:
        ratio = brentq(excess, 1e-5, 1 - 1e-6, xtol=1e-14)
        big, small = float(ellipkm1(ratio**2)), float(ellipe(1 - ratio**2))
        f1_cubed = (
            4 / (np.pi * (1 - ratio**2)) * ratio**1.5 * np.sqrt((small / ratio**2 - big) * (big - small))
        )
        factor = float(2 / np.pi * np.sqrt(ratio) * big / np.cbrt(f1_cubed))
    effective_mm = 1 / np.sqrt(flat * steep)
    # d^3 = 9 F^2 F2^3 / (16 E*^2 Re)  and  E* = S368 K^(3/2) F / d^(3/2) (1/R + 1/R')^(1/2)
    per_root = 0.75 * factor**1.5 / np.sqrt(effective_mm)
    return float((per_root / (S368 * np.sqrt(flat + steep))) ** (2 / 3))


#: the constant in every formula of ASABE S368
S368 = 0.338


def s368_parallel_plates_modulus_MPa(
    *, force_N: float, deformation_mm: float, poisson_ratio: float, radius_mm: float, other_radius_mm: float
) -> float:
    """Apparent modulus of a convex body between two flat plates, from the total deformation (like ends).

    E = 0.338 K^(3/2) F (1 - nu^2) / D^(3/2) [2 (1/R + 1/R')^(1/3)]^(3/2).  Source: ANSI/ASAE S368.4,
    "Compression test of food materials of convex shape".

    Two plates deform a sphere twice as much as one plate does: the inverse of `hertz_sphere_force_N`.

    >>> sphere = {"poisson_ratio": 0.5, "radius_mm": 25.0, "other_radius_mm": 25.0}
    >>> round(s368_parallel_plates_modulus_MPa(force_N=8.0, deformation_mm=2.0, **sphere), 6)
    0.9
    """
    shape = contact_shape_factor(radius_mm=radius_mm, other_radius_mm=other_radius_mm)
    curvature = 1 / radius_mm + 1 / other_radius_mm
    at_each_mm = deformation_mm / 2
    return float(S368 * shape**1.5 * force_N * (1 - poisson_ratio**2) / at_each_mm**1.5 * np.sqrt(curvature))


def cored_sphere_shrinkage_mm(
    *, E_MPa: float, poisson_ratio: float, core_radius_mm: float, radius_mm: float, pressure_MPa: float
) -> float:
    """Inward displacement of a sphere's skin under uniform outer pressure, around a bonded rigid core.

    Lame: u = A r + B / r^2, B = -A a^3 as u = 0 at the core; the radial stress at b,
    (3 lambda + 2 mu) A - 4 mu B / b^3, equals -p. Then u(b) = A (b - a^3 / b^2).
    Source: the spherical shell in Timoshenko and Goodier, "Theory of Elasticity", 1970, art. 136.

    Without a core the strain is p / (3 K), and K = 2/3 E at nu = 1/4.

    >>> ball = {"E_MPa": 1.0, "poisson_ratio": 0.25, "core_radius_mm": 1e-9, "radius_mm": 10.0}
    >>> round(cored_sphere_shrinkage_mm(**ball, pressure_MPa=0.1), 6)
    0.5
    """
    mu = E_MPa / (2 * (1 + poisson_ratio))
    three_bulk = E_MPa / (1 - 2 * poisson_ratio)
    ratio = (core_radius_mm / radius_mm) ** 3
    strain = pressure_MPa / (three_bulk + 4 * mu * ratio)
    return strain * radius_mm * (1 - ratio)

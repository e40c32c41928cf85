"""Spread of strain energy under a pressed ball: what turns a law of the flesh into a force-depth curve."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

#: classes of energy density that the field is sorted into
CLASSES = 40


def hertz_energy_density(
    r: Float[np.ndarray, " *x"], z: Float[np.ndarray, " *x"]
) -> Float[np.ndarray, " *x"]:
    """W/mu (R/a)^2 at radius r and depth z (in contact radii) in an incompressible half-space.

    With nu = 1/2 and psi = 1/(2 pi) int p/rho dS, u = (psi e_z - z grad psi)/(2 mu), so that the strain is
    -z/(2 mu) grad grad psi and W = z^2/(4 mu) |grad grad psi|^2. psi is a line of sources at imaginary
    depths, 1/(2 pi) int_{-1}^{1} q(s) / sqrt(r^2 + (z + i s)^2) ds with q = 4 mu (1 - s^2) for Hertz, and its
    second derivatives follow by parts from c = z + i, rho = sqrt(r^2 + c^2), L = ln(c + rho).
    Source: Johnson, "Contact Mechanics", 1985, sec. 3.2 (potentials) and 3.4 (Hertz).
    """
    c = z + 1j
    rho = np.sqrt(r**2 + c**2)
    log = np.log(c + rho)
    zz = 8 / np.pi * np.imag(log - 1j / rho)
    rz = -8 / np.pi * r * np.imag((1 - z / (c + rho)) / rho)
    tt = -4 / np.pi * np.imag(((1 + z**2) * c / r**2 + 2 * z - c) / rho + log)
    rr = -zz - tt
    return np.asarray(z**2 / 4 * (zz**2 + rr**2 + tt**2 + 2 * rz**2))


@lru_cache(maxsize=1)
def energy_classes() -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Energy density w (W/mu (R/a)^2) and volume (a^3) of classes of the field; sum of w volume is 32/15.

    The sum is F's own integral: int F dd with F = 16/3 mu a^3/R, d = a^2/R. The rescaled volumes keep it.
    """
    at, weight = np.polynomial.legendre.leggauss(90)
    angle, dangle = np.pi / 4 * (at + 1), np.pi / 4 * weight
    u, du = (at + 1) / 2, weight / 2
    far = 3.0 * u / (1 - u * 0.995)
    dfar = 3.0 / (1 - u * 0.995) ** 2 * du
    radius, turn = np.meshgrid(far, angle, indexing="ij")
    w = hertz_energy_density(radius * np.sin(turn), radius * np.cos(turn))
    volume = 2 * np.pi * radius**2 * np.sin(turn) * np.outer(dfar, dangle)
    order = np.argsort(w.ravel())
    w, volume = w.ravel()[order], volume.ravel()[order]
    edge = np.linspace(0, 1, CLASSES + 1)[1:-1] * np.sum(w * volume)
    group = np.searchsorted(edge, np.cumsum(w * volume))
    energy = np.bincount(group, w * volume, CLASSES)
    size = np.bincount(group, volume, CLASSES)
    return energy / size, size * (32 / 15 / energy.sum())


def force_share(
    density: Float[np.ndarray, " *s c"], slope: Float[np.ndarray, " *s c"], volume: Float[np.ndarray, " c"]
) -> Float[np.ndarray, " *s"]:
    """Force over Hertz's from a law's energy density and its slope, both in Hertz's own strain field.

    With W = mu (a/R)^2 w(x/a) the energy is U = mu a^5/R^2 int psi(w) dv, and F = dU/dd with d = a^2/R:
    F/F_Hertz = 3/32 (3 int psi dv + 2 int psi'(w) w dv), psi = w being 1. `slope` holds psi'(w) w.
    It is the force of Hertz's strains under the other law: for a stored energy an upper bound of the true
    energy (Ritz), exact to first order in the departure from the linear law.
    """
    return np.asarray(3 / 32 * (3 * density + 2 * slope) @ volume)

"""Distribution of strain energy under a ball, which converts a law of the flesh to a force-depth curve."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

#: quadrature points along the radius and over the angle, and outer radius of the field
POINTS, FAR = 90, 600.0


def hertz_energy_density(
    r: Float[np.ndarray, " *x"], z: Float[np.ndarray, " *x"], *, poisson_ratio: float
) -> Float[np.ndarray, " *x"]:
    """W/mu (R/a)^2 at radius r and depth z (in contact radii) in a nearly incompressible half-space.

    With nu = 1/2 and psi = 1/(2 pi) int p/rho dS, u = (psi e_z - z grad psi)/(2 mu), so that the strain is
    -z/(2 mu) grad grad psi, the pressure -d psi/dz, and W = z^2/(4 mu) |grad grad psi|^2. For nu below 1/2
    the pressure's energy, over 2 K, is added in the same field. psi is a line of sources at imaginary depths,
    1/(2 pi) int_{-1}^{1} q(s) / sqrt(r^2 + (z + i s)^2) ds with q = 4 mu (1 - s^2) for Hertz, and its
    derivatives follow by partial integration from c = z + i, rho = sqrt(r^2 + c^2), L = ln(c + rho).
    Source: Johnson, "Contact Mechanics", 1985, sec. 3.2 (potentials) and 3.4 (Hertz).
    """
    c = z + 1j
    rho = np.sqrt(r**2 + c**2)
    log = np.log(c + rho)
    zz = 8 / np.pi * np.imag(log - 1j / rho)
    rz = -8 / np.pi * r * np.imag((1 - z / (c + rho)) / rho)
    tt = -4 / np.pi * np.imag(((1 + z**2) * c / r**2 + 2 * z - c) / rho + log)
    rr = -zz - tt
    pressure = 8 / np.pi * np.imag(rho - z * log)
    shear = z**2 / 4 * (zz**2 + rr**2 + tt**2 + 2 * rz**2)
    bulk_over_mu = 2 * (1 + poisson_ratio) / (3 * (1 - 2 * poisson_ratio))
    return np.asarray(shear + pressure**2 / (2 * bulk_over_mu))


@lru_cache(maxsize=1)
def half_space() -> tuple[Float[np.ndarray, " x"], Float[np.ndarray, " x"], Float[np.ndarray, " x"]]:
    """Points r, z (contact radii) of a quadrature over the half-space, and their volumes."""
    at, weight = np.polynomial.legendre.leggauss(POINTS)
    share, angle = (at + 1) / 2, np.pi / 4 * (at + 1)
    end = 1 - 3.0 / FAR
    radius = 3.0 * share / (1 - share * end)
    growth = 3.0 / (1 - share * end) ** 2 * weight / 2
    volume = 2 * np.pi * np.outer(radius**2 * growth, np.sin(angle) * np.pi / 4 * weight)
    return np.outer(radius, np.sin(angle)).ravel(), np.outer(radius, np.cos(angle)).ravel(), volume.ravel()


def force_share(
    density: Float[np.ndarray, "*s x"], slope: Float[np.ndarray, "*s x"], *, poisson_ratio: float
) -> Float[np.ndarray, " *s"]:
    """Force over Hertz's from a law's energy density psi(w) at the points of `half_space`, and w psi'(w).

    With W = mu (a/R)^2 w(x/a) the energy is U = mu a^5/R^2 int psi(w) dv, and F = dU/dd with d = a^2/R:
    F/F_Hertz = (3 int psi dv + 2 int psi'(w) w dv)/(5 int w dv), which is 1 for psi = w.
    It is the force of Hertz's strains under the other law. For a stored energy, U is an upper bound of the
    true energy (Ritz), exact to first order in the deviation from the linear law.
    """
    r, z, volume = half_space()
    whole = hertz_energy_density(r, z, poisson_ratio=poisson_ratio) @ volume
    return np.asarray((3 * density + 2 * slope) @ volume / (5 * whole))

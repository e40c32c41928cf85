"""Elastic force of a rigid ball pressed into a slab that is bonded to a rigid base, for unit modulus."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from fem.indentation.contact_curve import THICK, ContactCurve, require_positive

#: largest contact radius of the table over the ball's radius
WIDEST = 0.99999
#: depth over radius beyond which strain is not small
DEEP = 0.5


def contact_radius_and_force(
    contact: Float[np.ndarray, " a"],
) -> tuple[Float[np.ndarray, " a"], Float[np.ndarray, " a"]]:
    """Depth over R and force over E* R^2 of a rigid sphere on a half-space, from contact radius over R.

    d = a/2 ln((1 + a)/(1 - a)),  F = (a^2 + 1)/2 ln((1 + a)/(1 - a)) - a,  all over R; E* = E/(1 - nu^2).
    Hertz's d = a^2, F = 4/3 a^3 is the limit of small a. Source: Sneddon, "The relation between load and
    penetration in the axisymmetric Boussinesq problem", Int. J. Engng Sci. 3, 1965, 47-57, sec. 6(c).

    Small contacts agree with Hertz: depth a^2, force 4/3 a^3.

    >>> depth, force = contact_radius_and_force(np.array([0.01]))
    >>> (depth / 0.01**2).round(3), (force / 0.01**3).round(3)
    (array([1.]), array([1.333]))
    """
    log = 2 * np.arctanh(contact)
    return contact / 2 * log, (contact**2 + 1) / 2 * log - contact


def slab_factor(width: Float[np.ndarray, " d"], *, poisson_ratio: float) -> Float[np.ndarray, " d"]:
    """Stiffness of a slab bonded to a rigid base over that of a half-space; width = sqrt(R d) / thickness.

    1 - 2 A/pi x + 4 A^2/pi^2 x^2 - 8/pi^3 (A^3 + 4 pi^2/15 B) x^3 + 16 A/pi^4 (A^3 + 3 pi^2/5 B) x^4 with
    A = -(1.2876 - 1.4678 nu + 1.3442 nu^2)/(1 - nu), B = (0.6387 - 1.0277 nu + 1.5164 nu^2)/(1 - nu);
    valid for x up to 1. (At nu = 1/2 the last term is -0.0975 x^4; the paper prints it with a plus sign, a
    difference of 1 % of the force at x = 0.5.) Source: Dimitriadis, Horkay, Maresca, Kachar, Chadwick,
    "Determination of elastic moduli of thin layers of soft material using the atomic force microscope",
    Biophys. J. 82, 2002, 2798-2810.

    A thick slab is a half-space.

    >>> slab_factor(np.array([0.0]), poisson_ratio=0.5)
    array([1.])
    """
    nu = poisson_ratio
    A = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    B = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    pi = np.pi
    cubic = -8 / pi**3 * (A**3 + 4 * pi**2 / 15 * B)
    quartic = 16 * A / pi**4 * (A**3 + 3 * pi**2 / 5 * B)
    return np.asarray(
        1 - 2 * A / pi * width + 4 * A**2 / pi**2 * width**2 + cubic * width**3 + quartic * width**4
    )


@dataclass(frozen=True, kw_only=True)
class Ball:
    """A rigid ball on flesh."""

    radius_mm: float
    tool: ClassVar[str] = "ball"

    def __post_init__(self) -> None:
        require_positive("radius", self.radius_mm, "give the ball's")

    @property
    def said(self) -> str:
        """For reports."""
        return f"ball of radius {self.radius_mm:g} mm"

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> ContactCurve:
        """Hertz's force times Sneddon's and Dimitriadis's factors, as splines in the root of depth over R.

        Valid up to a depth of five radii; the true contact radius a replaces sqrt(R d) in the slab's factor.
        """
        contact = WIDEST * np.sin(np.linspace(0, np.pi / 2, 400)[1:])
        depth, force = contact_radius_and_force(contact)
        slab = np.ones(len(depth))
        if thickness_mm is not None:
            slab = slab_factor(contact * self.radius_mm / thickness_mm, poisson_ratio=poisson_ratio)
        root = np.r_[0, np.sqrt(depth)]
        of_slab = CubicSpline(root, np.r_[1, slab])
        over_hertz = CubicSpline(root, np.r_[1, force / (4 / 3 * depth**1.5) * slab])
        hertz = 4 / 3 / (1 - poisson_ratio**2) * self.radius_mm**2

        def over_radius(depth_mm: np.ndarray) -> np.ndarray:
            return np.asarray(np.maximum(depth_mm, 0.0) / self.radius_mm)

        def force_N_per_MPa(depth_mm: np.ndarray) -> np.ndarray:
            deep = over_radius(depth_mm)
            return np.asarray(hertz * deep**1.5 * over_hertz(np.sqrt(deep)))

        return ContactCurve(
            poisson_ratio=poisson_ratio,
            length_mm=self.radius_mm,
            force_N_per_MPa=force_N_per_MPa,
            over_half_space=lambda depth_mm: of_slab(np.sqrt(over_radius(depth_mm))),
            trusted_mm=DEEP * self.radius_mm,
            size_mm=self.radius_mm,
            beyond="The ball went {:.1f} of its radii deep, where small strain has ended: stiffening may be "
            "the geometry's in part.",
            notes=THICK if thickness_mm is None else (),
        )

"""Elastic force of a rigid flat-ended cylinder pressed into a slab that is bonded to a rigid base."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.polynomial.legendre import leggauss

from fem.indentation.contact_curve import THICK, ContactCurve, out_of_range, require_positive

#: largest radius over thickness compared with finite elements (tests/fem/test_compressed_cylinder.py)
THINNEST = 2.0
#: Gauss points over the punch's radius, and over wave numbers up to MOST_WAVES; doubling them changes the
#: factor by less than 1e-6
POINTS = (40, 200)
#: wave number times thickness beyond which the base has no influence: the kernel is below 1e-15
MOST_WAVES = 20.0
HARDNESS = 2.845
"""Mean pressure over yield stress at which flesh flows under a smooth punch: 5.69 k, k = Y/2 (Tresca).
Source: Shield, "On the plastic flow of metals under conditions of axial symmetry", Proc. R. Soc. A 233,
1955."""
#: depth over radius up to which small strain is valid: finite strain changes the force by about a hundredth
#: (benchmarks/indentation_geometries.py)
DEEP = 0.2
RIM = (
    "the strain at the punch's rim has no bound, so that the law of a small volume says nothing of the force"
)


def slab_factor_of_punch(over_thickness: float, *, poisson_ratio: float) -> float:
    """Stiffness of a slab bonded to a rigid base over that of a half-space, under a smooth punch.

    `over_thickness`: the punch's radius over the slab's thickness; the factor is dimensionless. The function
    solves the Fredholm equation for the punch, phi(t) - integral over [0, 1] of K(t, s) phi(s) ds = 1, with
    K = 2 a/(pi h) integral of (1 - L(x)) cos(x t a/h) cos(x s a/h) dx and the layer's
    L = (2 k sinh 2x - 4x)/(2 k cosh 2x + 4x^2 + 1 + k^2), k = 3 - 4 nu; the factor is the mean of phi.
    Source: Lebedev and Ufliand, "Axisymmetric contact problem for an elastic layer", J. Appl. Math. Mech. 22,
    1958, 442-450; Hayes, Keer, Herrmann, Mockros, "A mathematical analysis for indentation tests of articular
    cartilage", J. Biomech. 5, 1972, 541-551.
    """
    nodes, weights = (array / 2 for array in leggauss(POINTS[0]))
    nodes = nodes + 0.5
    waves, steps = (MOST_WAVES * array / 2 for array in leggauss(POINTS[1]))
    waves = waves + MOST_WAVES / 2
    k = 3 - 4 * poisson_ratio
    layer = (2 * k * np.sinh(2 * waves) - 4 * waves) / (2 * k * np.cosh(2 * waves) + 4 * waves**2 + 1 + k**2)
    cosines = np.cos(over_thickness * np.outer(nodes, waves))
    kernel = 2 / np.pi * over_thickness * (cosines * ((1 - layer) * steps)) @ cosines.T
    return float(weights @ np.linalg.solve(np.eye(len(nodes)) - kernel * weights, np.ones(len(nodes))))


@dataclass(frozen=True, kw_only=True)
class FlatPunch:
    """The flat end of a rigid cylinder on wider flesh."""

    radius_mm: float
    tool: ClassVar[str] = "punch"

    def __post_init__(self) -> None:
        require_positive("radius", self.radius_mm, "give the punch's")

    @property
    def said(self) -> str:
        """For reports."""
        return f"flat punch of radius {self.radius_mm:g} mm"

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> ContactCurve:
        """F = 2 a kappa d E/(1 - nu^2), kappa the slab's factor: linear, since the contact does not grow.

        Raises FemFailure (bad-load) if the flesh is thinner than half a radius. Source: Sneddon, "The
        relation between load and penetration in the axisymmetric Boussinesq problem", Int. J. Engng Sci. 3,
        1965, 47-57, sec. 6(a).
        """
        over = 0.0 if thickness_mm is None else self.radius_mm / thickness_mm
        if over > THINNEST:
            raise out_of_range(
                f"a punch of radius {self.radius_mm:g} mm on {thickness_mm:g} mm of flesh",
                f"at most {THINNEST:g} thicknesses: a specimen no wider than the tool is a cylinder between "
                "plates (--indenter plates --specimen cylinder)",
            )
        kappa = slab_factor_of_punch(over, poisson_ratio=poisson_ratio)
        slope = 2 * self.radius_mm * kappa / (1 - poisson_ratio**2)
        return ContactCurve(
            poisson_ratio=poisson_ratio,
            length_mm=self.radius_mm,
            force_N_per_MPa=lambda depth_mm: np.asarray(slope * np.maximum(depth_mm, 0.0)),
            trusted_mm=DEEP * self.radius_mm,
            size_mm=self.radius_mm,
            beyond="The punch went {:.2f} of its radius deep, where small strain has ended, and a sharp rim "
            "cuts: E may be off by more than its interval.",
            notes=THICK if thickness_mm is None else (),
            field="rim",
            yield_depth_mm=HARDNESS * np.pi * self.radius_mm**2 / slope,
            without={"stiffening": RIM, "damage": RIM},
        )

"""Elastic force of a rigid flat-ended cylinder pressed into a slab that is bonded to a rigid base."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RectBivariateSpline

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.contact_curve import Field, require_positive

#: radius over thickness, Poisson's ratios, and the factor kappa on the half-space's force. Source: Hayes,
#: Keer, Herrmann, Mockros, "A mathematical analysis for indentation tests of articular cartilage", J.
#: Biomech. 5, 1972, 541-551, table 1 (frictionless punch); finite elements agree to a hundredth
#: (tests/fem/test_flat_punch.py)
OVER_THICKNESS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0)
#: of the rows of KAPPA
POISSON_RATIOS = (0.30, 0.35, 0.40, 0.45, 0.50)
#: Hayes's factor, dimensionless, a row for each ratio and a column for each radius over thickness
KAPPA = (
    (1.0, 1.207, 1.472, 1.784, 2.124, 2.480, 3.400, 4.336),
    (1.0, 1.218, 1.502, 1.839, 2.211, 2.603, 3.629, 4.685),
    (1.0, 1.232, 1.542, 1.917, 2.337, 2.789, 3.996, 5.271),
    (1.0, 1.252, 1.599, 2.031, 2.532, 3.085, 4.638, 6.380),
    (1.0, 1.281, 1.683, 2.211, 2.855, 3.609, 5.970, 9.069),
)
HARDNESS = 2.845
"""Mean pressure over yield stress at which flesh flows under a smooth punch: 5.69 k, k = Y/2 (Tresca).
Source: Shield, "On the plastic flow of metals under conditions of axial symmetry", Proc. R. Soc. A 233,
1955."""
#: depth over radius up to which small strain holds: finite strain then moves the force by about a hundredth
#: (benchmarks/indentation_geometries.py)
DEEP = 0.2
RIM = (
    "the strain at the punch's rim has no bound, so that the law of a small volume says nothing of the force"
)


@dataclass(frozen=True, kw_only=True)
class FlatPunch:
    """A rigid cylinder's flat end on flesh that is wider."""

    radius_mm: float

    def __post_init__(self) -> None:
        require_positive("radius", self.radius_mm, "give the punch's")

    @property
    def tool(self) -> str:
        """What moves."""
        return "punch"

    @property
    def said(self) -> str:
        """For reports."""
        return f"flat punch of radius {self.radius_mm:g} mm"

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> "PunchOnSlab":
        """Boussinesq's, on a slab Hayes's; raises FemFailure (bad-load) for a slab too thin for the table."""
        over = 0.0 if thickness_mm is None else self.radius_mm / thickness_mm
        if over > OVER_THICKNESS[-1]:
            raise FemFailure(
                FemProblem.BAD_LOAD,
                f"indenter trace: found a punch of radius {self.radius_mm:g} mm on {thickness_mm:g} mm of "
                f"flesh, expected at most {OVER_THICKNESS[-1]:g} thicknesses: a specimen no wider "
                "than the tool is a cylinder between plates (--indenter plates --specimen cylinder).",
            )
        table = RectBivariateSpline(POISSON_RATIOS, OVER_THICKNESS, np.log(KAPPA))
        ratio = max(poisson_ratio, POISSON_RATIOS[0])
        return PunchOnSlab(
            radius_mm=self.radius_mm,
            thickness_mm=thickness_mm,
            poisson_ratio=poisson_ratio,
            kappa=float(np.exp(table.ev(np.array(ratio), np.array(over)))),
        )


@dataclass(frozen=True, kw_only=True)
class PunchOnSlab:
    """F = 2 a kappa d E/(1 - nu^2): linear in depth, since the contact does not grow.

    Source: Sneddon, "The relation between load and penetration in the axisymmetric Boussinesq problem",
    Int. J. Engng Sci. 3, 1965, 47-57, sec. 6(a). `kappa`: the slab's factor (KAPPA).
    """

    radius_mm: float
    thickness_mm: float | None
    poisson_ratio: float
    kappa: float

    @property
    def length_mm(self) -> float:
        """The radius."""
        return self.radius_mm

    @property
    def field(self) -> Field:
        """Stress grows at the rim as the root of the distance falls."""
        return "rim"

    @property
    def yield_depth_mm(self) -> float | None:
        """Where the mean pressure reaches Shield's."""
        return HARDNESS * np.pi * self.radius_mm * (1 - self.poisson_ratio**2) / (2 * self.kappa)

    @property
    def without(self) -> Mapping[str, str]:
        """Laws of the strain energy."""
        return {"stiffening": RIM, "damage": RIM}

    @property
    def shape_sd(self) -> float:
        """The table and its interpolation (tests/fem/test_flat_punch.py)."""
        return 0.01

    def force_N_per_MPa(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """phi(d): nothing out of contact."""
        slope = 2 * self.radius_mm * self.kappa / (1 - self.poisson_ratio**2)
        return np.asarray(slope * np.maximum(depth_mm, 0.0))

    def energy_strain(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """(d/a)^2: of the order of what flesh away from the rim has."""
        return np.asarray((np.maximum(depth_mm, 0.0) / self.radius_mm) ** 2)

    def over_half_space(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """kappa at every depth."""
        return np.full(np.shape(depth_mm), self.kappa)

    def notes(self, deepest_mm: float) -> tuple[str, ...]:
        """Ranges left, and a half-space that nobody stated."""
        found = []
        if deepest_mm > DEEP * self.radius_mm:
            found.append(
                f"The punch went {deepest_mm / self.radius_mm:.2f} of its radius deep, where small strain "
                "has ended, and a sharp rim cuts: E may be off by more than its interval."
            )
        if self.thickness_mm is None:
            found.append(
                "No thickness was given: a half-space was assumed, and a thin specimen looks stiffer."
            )
        elif self.poisson_ratio < POISSON_RATIOS[0]:
            found.append(
                f"The slab's factor is that of Poisson's ratio {POISSON_RATIOS[0]:g}, the least that is "
                "tabulated; it is a few per cent too large."
            )
        return tuple(found)

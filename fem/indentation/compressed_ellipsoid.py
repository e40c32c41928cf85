"""Elastic force of a fruit, an ellipsoid around a rigid pit, between two rigid plates."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline, RegularGridInterpolator

from fem.indentation.contact_curve import (
    ContactCurve,
    near_incompressible,
    out_of_range,
    require_no_thickness,
    require_positive,
    straight_on,
    tabulated,
)
from fem.solid.closed_forms import s368_parallel_plates_modulus_MPa

TABLE = "compressed_spheroid.csv"
"""Force over Hertz's of neo-Hookean spheroids around a rigid pit, by axisymmetric finite elements
(benchmarks/indentation_geometries.py --write): nu, pit's share, diameter between the plates over that across,
approach over the diameter between the plates, ratio."""
TRUSTED_SQUEEZE = 0.2
"""Approach over the diameter up to which the law is trusted."""
LARGEST_PIT = 0.65
"""Largest pit of the table, as a share of the diameter."""
CURVATURE_SD = 0.15
"""Relative standard deviation of a fruit's radii of curvature about those of the ellipsoid with its diameters
(set by hand: cheeks are flatter, shoulders steeper). E is proportional to their product to the power -1/4."""
PIT_SD = 0.1
"""Relative standard deviation of the pit's share (set by hand: the scatter within a cultivar)."""
LONGEST = 1.6
"""Largest ratio of two diameters: the end of the table."""


@dataclass(frozen=True, kw_only=True)
class Ellipsoid:
    """A fruit with three diameters, squeezed along one of them (`axis`, 0 to 2) between two plates.

    `pit_share`: the pit's diameter over the fruit's; 0 without a pit. The pit is a concentric ellipsoid of
    the same shape, bonded to the flesh.
    """

    diameters_mm: tuple[float, float, float]
    axis: int
    pit_share: float
    tool: ClassVar[str] = "plate"

    def __post_init__(self) -> None:
        for diameter_mm in self.diameters_mm:
            require_positive("diameter", diameter_mm, "give the fruit's three")
        if max(self.diameters_mm) > LONGEST * min(self.diameters_mm):
            said = " x ".join(f"{diameter_mm:g}" for diameter_mm in self.diameters_mm)
            raise out_of_range(
                f"diameters of {said} mm",
                f"none more than {LONGEST:g} times another: check them; of longer bodies cut a cylinder",
            )
        if not 0 <= self.pit_share <= LARGEST_PIT:
            raise out_of_range(
                f"a pit of {self.pit_share:g} of the fruit's diameter",
                f"0 to {LARGEST_PIT:g}: give diameter over diameter",
            )

    @property
    def said(self) -> str:
        """For reports."""
        size = " x ".join(f"{diameter_mm:g}" for diameter_mm in self.diameters_mm)
        pit = f"a pit of {self.pit_share:.0%} of it" if self.pit_share else "no pit"
        return f"plates on a fruit of {size} mm, squeezed along {self.along_mm:g} mm, with {pit}"

    @property
    def along_mm(self) -> float:
        """The diameter between the plates."""
        return self.diameters_mm[self.axis]

    @property
    def along_over_across(self) -> float:
        """That diameter over the geometric mean of the other two."""
        others = [d for k, d in enumerate(self.diameters_mm) if k != self.axis]
        return float(self.along_mm / np.sqrt(np.prod(others)))

    @property
    def radii_mm(self) -> tuple[float, float]:
        """Principal radii of curvature where the plates touch: p^2/s of the semi-axes."""
        p, q = (d / 2 for k, d in enumerate(self.diameters_mm) if k != self.axis)
        return p**2 / (self.along_mm / 2), q**2 / (self.along_mm / 2)

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> ContactCurve:
        """Force as a function of the approach of the plates, half of it at each contact.

        F = E (d/2)^(3/2)/(0.338 K^(3/2) (1 - nu^2) ...) of ANSI/ASAE S368.4 (Hertz with the principal radii
        where the plates touch), times a table's factor on Hertz for other side, large deformation and pit.
        Its spheroids are neo-Hookean with rigid pits, with the same diameter along the axis and the
        same mean one across, at the same squeeze. The length is twice the mean radius R: (a/R)^2 = d/(2 R).
        Raises FemFailure (bad-load) if a thickness is given.
        """
        require_no_thickness(thickness_mm, "a fruit's is its diameter between the plates")
        radius_mm, other_mm = self.radii_mm
        hertz = 1 / s368_parallel_plates_modulus_MPa(
            force_N=1.0,
            deformation_mm=1.0,
            poisson_ratio=poisson_ratio,
            radius_mm=radius_mm,
            other_radius_mm=other_mm,
        )
        over_hertz = spheroid_over_hertz(poisson_ratio, self.pit_share, self.along_over_across)

        def over_half_space(depth_mm: np.ndarray) -> np.ndarray:
            return straight_on(over_hertz, np.asarray(np.sqrt(np.maximum(depth_mm, 0.0) / self.along_mm)))

        def force_N_per_MPa(depth_mm: np.ndarray) -> np.ndarray:
            return np.asarray(hertz * np.maximum(depth_mm, 0.0) ** 1.5 * over_half_space(depth_mm))

        return ContactCurve(
            poisson_ratio=poisson_ratio,
            length_mm=2 * float(np.sqrt(radius_mm * other_mm)),
            force_N_per_MPa=force_N_per_MPa,
            over_half_space=over_half_space,
            trusted_mm=TRUSTED_SQUEEZE * self.along_mm,
            size_mm=self.along_mm,
            beyond="The fruit was squeezed by {:.0%} of its diameter, beyond the "
            f"{TRUSTED_SQUEEZE:.0%} that its law is held to.",
            notes=(
                f"The fruit's shape (three diameters, its pit's size) leaves another ± "
                f"{self.shape_sd(poisson_ratio):.0%} of E, which its interval does not hold; it is common to "
                "all squeezes of this fruit.",
            ),
        )

    def shape_sd(self, poisson_ratio: float) -> float:
        """Standard deviation of ln E by curvature (two independent radii of CURVATURE_SD, E to the power
        -1/4 of their product) and pit (PIT_SD), at half the trusted squeeze.
        """
        curvature = CURVATURE_SD / np.sqrt(8)
        root = np.sqrt(TRUSTED_SQUEEZE / 2)
        less, more = (
            spheroid_over_hertz(poisson_ratio, min(share, LARGEST_PIT), self.along_over_across)(root)
            for share in ((1 - PIT_SD) * self.pit_share, (1 + PIT_SD) * self.pit_share)
        )
        return float(np.hypot(curvature, np.log(more / less) / 2))


@lru_cache(maxsize=1)
def spheroid_table() -> RegularGridInterpolator:
    """Logarithm of the ratio over -ln(1 - 2 nu), pit, ln of length over width, and root of the squeeze."""
    (nus, pits, longs, squeezes), log_ratio = tabulated(TABLE)
    grid = (near_incompressible(nus), pits, np.log(longs), np.r_[0.0, np.sqrt(squeezes)])
    return RegularGridInterpolator(grid, np.pad(log_ratio, [(0, 0)] * 3 + [(1, 0)]), method="cubic")


@lru_cache(maxsize=64)
def spheroid_over_hertz(poisson_ratio: float, pit_share: float, along_over_across: float) -> CubicSpline:
    """Force over Hertz's as a function of the root of approach over the diameter along it; 1 at zero squeeze.

    Poisson's ratios outside the table are clipped to its range, an error below a hundredth of the force.
    """
    table = spheroid_table()
    at, _, _, roots = table.grid
    nu = near_incompressible(poisson_ratio).clip(at[0], at[-1])
    others = np.broadcast_to([nu, pit_share, np.log(along_over_across)], (len(roots), 3))
    return CubicSpline(roots, np.exp(table(np.column_stack([others, roots]))))

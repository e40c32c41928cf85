"""Elastic force of a cylinder of flesh between rigid plates, with sliding, bonded or intermediate ends."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline, RegularGridInterpolator
from scipy.optimize import brentq

from fem.fem_failure import FemFailure
from fem.indentation.contact_curve import (
    ContactCurve,
    OfDepth,
    near_incompressible,
    out_of_range,
    require_no_thickness,
    require_positive,
    straight_on,
    tabulated,
)

TABLE = "bonded_cylinder.csv"
"""Nominal stress over E and strain of bonded neo-Hookean cylinders, by axisymmetric finite elements
(benchmarks/indentation_geometries.py --write): Poisson's ratio, height over diameter, strain, ratio. One
value, at the corner of 0.495, 0.25 and 0.3, is extrapolated by the last step of the elements, which
stop before it."""
LARGEST_STRAIN = 0.8
"""End of the curve for sliding ends; a search may go this far."""
TOE_SHARE = 0.01
"""Typical spread of first touches of an end over its diameter: about half a degree out of parallel."""
TRUSTED_STRAIN = {"lubricated": 0.3, "bonded": 0.2, None: 0.2}
"""Strain up to which flesh follows the law, apart from `bend` and stiffening. Beyond 0.2, bulging sides of
bonded ends touch the plates, and meshes differ by more than a hundredth."""

Ends: TypeAlias = Literal["bonded", "lubricated"]


@lru_cache(maxsize=8)
def sliding_stress(poisson_ratio: float) -> CubicSpline:
    """Nominal stress over E against nominal strain, sliding ends: a compressible neo-Hookean solid.

    P = mu (l - 1/l) + lambda ln J / l along the axis and zero across; E e at small strain, and
    (l^-2 - l)/3 for nu = 1/2. Source: Bonet and Wood, "Nonlinear Continuum Mechanics for Finite Element
    Analysis", 2nd ed., 2008, eq. 6.28.
    """
    nu = poisson_ratio
    lam, mu = nu / ((1 + nu) * (1 - 2 * nu)), 1 / (2 * (1 + nu))

    def stress(along: float) -> float:
        def across_stress(across: float) -> float:
            return float(mu * (across - 1 / across) + lam * np.log(along * across**2) / across)

        across = brentq(across_stress, 0.9, 2 / np.sqrt(along), xtol=1e-14)
        return float(-(mu * (along - 1 / along) + lam * np.log(along * across**2) / along))

    strain = np.linspace(0, LARGEST_STRAIN, 61)
    return CubicSpline(strain, [0.0, *(stress(1 - e) for e in strain[1:])])


@lru_cache(maxsize=1)
def bonded_table() -> RegularGridInterpolator:
    """Logarithm of the ratio over -ln(1 - 2 nu), ln of height over diameter, and strain."""
    (nus, heights, strains), log_ratio = tabulated(TABLE)
    grid = (near_incompressible(nus), np.log(heights), strains)
    return RegularGridInterpolator(grid, log_ratio, method="cubic")


def bonded_stress(slender: float, *, poisson_ratio: float) -> CubicSpline:
    """Nominal stress over E against nominal strain, bonded ends; `slender` is height over diameter.

    Raises FemFailure (bad-load) outside the table.
    """
    table = bonded_table()
    at, logs, strains = table.grid
    here = [float(near_incompressible(poisson_ratio)), np.log(slender)]
    if not logs[0] <= here[1] <= logs[-1]:
        raise out_of_range(
            f"a bonded cylinder of height {slender:.3g} diameters",
            f"{np.exp(logs[0]):.3g} to {np.exp(logs[-1]):.3g}: cut another specimen, or let its ends slide "
            "on oil",
        )
    if not at[0] <= here[0] <= at[-1]:
        nus = (1 - np.exp(-at)) / 2
        raise out_of_range(
            f"Poisson's ratio {poisson_ratio:g} of a bonded cylinder",
            f"{nus[0]:g} to {nus[-1]:g}: nearer to 1/2 its stiffness is the bulk modulus's",
        )
    ratio = np.exp(table(np.column_stack([np.tile(here, (len(strains), 1)), strains])))
    return CubicSpline(np.r_[0.0, strains], np.r_[0.0, ratio * strains])


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """A cylinder of flesh squeezed along its axis. `ends` slide without friction or are bonded; None: a state
    between, to be fitted.
    """

    diameter_mm: float
    height_mm: float
    ends: Ends | None
    tool: ClassVar[str] = "plate"

    def __post_init__(self) -> None:
        require_positive("diameter", self.diameter_mm, "give the specimen's")
        require_positive("height", self.height_mm, "give the specimen's, unloaded")

    @property
    def said(self) -> str:
        """For reports."""
        size = f"{self.diameter_mm:g} mm wide, {self.height_mm:g} mm high"
        return f"plates on a cylinder {size}, its ends {self.ends or 'not stated'}"

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> ContactCurve:
        """Force A s(d/H), A the undeformed end.

        The law is neo-Hookean at finite strain, unlike a ball's at small strain: a lubricated rubber cylinder
        is then `none`, not stiffening. Bonded ends flow at 1 + D/(3 root(3) H) times the yield stress
        (Johnson and Mellor, "Engineering Plasticity", 1973, sec. 6: disc between rough dies) and are stiffer.
        Raises FemFailure (bad-load) for bonded cylinders outside the table, and if a thickness is given.
        """
        require_no_thickness(thickness_mm, "a cylinder's is its height")
        slender, area_mm2 = self.height_mm / self.diameter_mm, np.pi * self.diameter_mm**2 / 4
        sliding = sliding_stress(poisson_ratio)
        held = None
        if self.ends != "lubricated":
            held = _held_over_sliding(bonded_stress(slender, poisson_ratio=poisson_ratio), sliding)
        stated = held if self.ends == "bonded" else None
        stiffer = 1.0 if stated is None else float(stated(np.zeros(1))[0])
        carried = 1.0 if stated is None else 1 + 1 / (3 * np.sqrt(3) * slender)
        trusted = TRUSTED_STRAIN[self.ends]

        def force_N_per_MPa(depth_mm: np.ndarray) -> np.ndarray:
            strain = np.asarray(np.maximum(depth_mm, 0.0) / self.height_mm)
            force = area_mm2 * straight_on(sliding, strain)
            return force if stated is None else force * stated(strain)

        return ContactCurve(
            poisson_ratio=poisson_ratio,
            length_mm=self.height_mm,
            force_N_per_MPa=force_N_per_MPa,
            trusted_mm=trusted * self.height_mm,
            size_mm=self.height_mm,
            beyond=f"The specimen was squeezed by {{:.0%}} of its height, beyond the {trusted:.0%} that its "
            "law is held to.",
            notes=self._of_ends(poisson_ratio, stiffer),
            field="uniform",
            yield_depth_mm=float(self.height_mm * carried / stiffer),
            held_over_sliding=None
            if held is None or self.ends is not None
            else lambda depth_mm: held(np.asarray(depth_mm) / self.height_mm),
            stiffer_ends=stiffer,
            toe_mm=TOE_SHARE * self.diameter_mm,
        )

    def _of_ends(self, poisson_ratio: float, stiffer: float) -> tuple[str, ...]:
        """Notes on how stated ends affect E."""
        if self.ends is None:
            return ()
        if self.ends == "bonded":
            return (f"Its ends are taken as held: if they slid, E would be {stiffer:.2f} times as much.",)
        try:
            slender = self.height_mm / self.diameter_mm
            held = float(bonded_stress(slender, poisson_ratio=poisson_ratio)(0.0, 1))
            said = f"E would be {1 / held:.2f} times as much"
        except FemFailure:
            said = "E would be less"
        return (f"Its ends are taken as sliding without friction: if they were held, {said}.",)


def _held_over_sliding(bonded: CubicSpline, sliding: CubicSpline) -> OfDepth:
    """Stress with bonded ends over that with sliding ends, as a function of strain. Beyond the table it
    decays exponentially towards 1, from its last slope.

    Coarse finite elements, up to a strain of 0.44, are within 5 % (tests/fem/test_compressed_cylinder.py).
    Like the table, they let bulging sides pass through the plates. Sides that fold onto the plates make the
    ratio grow again from a strain of 0.4 on (benchmarks/results/indentation_geometries.csv).
    """
    strains = bonded.x[1:]
    ratio = CubicSpline(strains, bonded(strains) / sliding(strains))
    first, end = strains[[0, -1]]
    falls = float(ratio(end, 1) / (ratio(end) - 1))

    def at(strain: np.ndarray) -> np.ndarray:
        within = ratio(np.clip(strain, first, end))
        return np.asarray(1 + (within - 1) * np.exp(falls * np.maximum(strain - end, 0.0)))

    return at

"""Elastic force of a cylinder of flesh between two rigid plates, its ends sliding, held, or between."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.optimize import brentq

from fem.fem_failure import FemFailure
from fem.indentation.contact_curve import (
    ContactCurve,
    Field,
    out_of_range,
    require_no_thickness,
    require_positive,
)

TABLE = Path(__file__).parent / "tables" / "bonded_cylinder.csv"
"""Nominal stress over E and strain of bonded neo-Hookean cylinders, by axisymmetric finite elements
(benchmarks/indentation_geometries.py --write): Poisson's ratio, height over diameter, strain, ratio."""
LARGEST_STRAIN = 0.8
"""Up to which sliding ends' curve is drawn; a search may look so far."""
TOE_SHARE = 0.01
"""Typical width of the first touches of an end over its diameter: about half a degree out of parallel."""
TRUSTED_STRAIN = {"lubricated": 0.3, "bonded": 0.2, None: 0.2}
"""Up to which flesh is taken to follow the law, less what `bend` and stiffening take up; beyond the
second, sides that bulge come to lie on the plates, and meshes differ by more than a hundredth."""

Ends: TypeAlias = Literal["bonded", "lubricated"]


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """A cylinder of flesh squeezed along its axis; `ends` that slide without friction, or not at all; None:
    anything between, to be found.
    """

    diameter_mm: float
    height_mm: float
    ends: Ends | None

    def __post_init__(self) -> None:
        require_positive("diameter", self.diameter_mm, "give the specimen's")
        require_positive("height", self.height_mm, "give the specimen's, unloaded")

    @property
    def tool(self) -> str:
        """What moves."""
        return "plate"

    @property
    def said(self) -> str:
        """For reports."""
        size = f"{self.diameter_mm:g} mm wide, {self.height_mm:g} mm high"
        return f"plates on a cylinder {size}, its ends {self.ends or 'not stated'}"

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> "CompressedCylinder":
        """Uniaxial compression, or the table of bonded ends.

        Raises FemFailure (bad-load) for bonded cylinders beyond the table, and where a thickness is given.
        """
        require_no_thickness(thickness_mm, "a cylinder's is its height")
        sliding, held = sliding_stress(poisson_ratio), None
        if self.ends != "lubricated":
            bonded = bonded_stress(self.height_mm / self.diameter_mm, poisson_ratio=poisson_ratio)
            strain = bonded.x[1:]
            held = CubicSpline(strain, bonded(strain) / sliding(strain))
        return CompressedCylinder(
            specimen=self, poisson_ratio=poisson_ratio, sliding=sliding, held_over_sliding_at=held
        )


@lru_cache(maxsize=8)
def sliding_stress(poisson_ratio: float) -> CubicSpline:
    """Nominal stress over E against nominal strain, sliding ends: a compressible neo-Hookean solid.

    P = mu (l - 1/l) + lambda ln J / l along the axis and nothing across; E e at small strain, and
    (l^-2 - l)/3 where nu is 1/2. Source: Bonet and Wood, "Nonlinear Continuum Mechanics for Finite Element
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
def bonded_table() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Poisson's ratios, heights over diameter, strains, and the ratio (nu, height, strain)."""
    rows = np.genfromtxt(TABLE, delimiter=",", skip_header=1)
    nus, heights, strains = (np.unique(rows[:, k]) for k in range(3))
    return nus, heights, strains, rows[:, 3].reshape(len(nus), len(heights), len(strains))


def bonded_stress(slender: float, *, poisson_ratio: float) -> CubicSpline:
    """Nominal stress over E against nominal strain, bonded ends; `slender` is height over diameter.

    Raises FemFailure (bad-load) outside the table.
    """
    nus, heights, strains, ratio = bonded_table()
    if not heights[0] <= slender <= heights[-1]:
        raise out_of_range(
            f"a bonded cylinder of height {slender:.3g} diameters",
            f"{heights[0]:g} to {heights[-1]:g}: cut another specimen, or let its ends slide on oil",
        )
    if not nus[0] <= poisson_ratio <= nus[-1]:
        raise out_of_range(
            f"Poisson's ratio {poisson_ratio:g} of a bonded cylinder",
            f"{nus[0]:g} to {nus[-1]:g}: nearer to 1/2 its stiffness is the bulk modulus's",
        )
    # close to 1/2 a thin disc stiffens with 1 - 2 nu alone, which evens the table out
    at, here = -np.log(1 - 2 * nus), float(-np.log(1 - 2 * poisson_ratio))
    known = np.isfinite(ratio)
    near = np.ix_(_neighbours(at, here), _neighbours(heights, slender))
    count = int(known[near].sum(axis=2).min())
    logs = np.log(_continued(ratio))
    log_ratios = [
        float(
            RectBivariateSpline(at, np.log(heights), logs[:, :, k]).ev(np.array(here), np.log([slender]))[0]
        )
        for k in range(count)
    ]
    return CubicSpline(np.r_[0.0, strains[:count]], np.r_[0.0, np.exp(log_ratios) * strains[:count]])


def _neighbours(nodes: Float[np.ndarray, " n"], value: float) -> Int[np.ndarray, "2"]:
    """The nodes on both sides of a value."""
    after = int(np.clip(np.searchsorted(nodes, value), 1, len(nodes) - 1))
    return np.arange(after - 1, after + 1)


def _continued(ratio: Float[np.ndarray, "n h s"]) -> Float[np.ndarray, "n h s"]:
    """The table with what its finite elements did not reach put on by the last step: it is not read itself,
    and keeps the splines through the neighbours even.
    """
    ratio = ratio.copy()
    for k in range(2, ratio.shape[2]):
        lost = ~np.isfinite(ratio[:, :, k])
        ratio[lost, k] = (ratio[:, :, k - 1] ** 2 / ratio[:, :, k - 2])[lost]
    return ratio


@dataclass(frozen=True, kw_only=True)
class CompressedCylinder(ContactCurve):
    """Force A s(d/H) per unit modulus, A the undeformed end; `sliding` s has its last slope beyond its end.

    The law is neo-Hookean in true geometry, not the small strain of a ball's: a lubricated rubber cylinder
    is then `none`, not stiffening. Held ends multiply s by `held_over_sliding_at` the strain, None where they
    slide. Beyond the table it falls towards 1 with its last slope; coarse finite elements, up to a strain of
    0.44, are within 5 % (tests/fem/test_compressed_cylinder.py).
    """

    specimen: Cylinder
    poisson_ratio: float
    sliding: CubicSpline
    held_over_sliding_at: CubicSpline | None

    @property
    def length_mm(self) -> float:
        """The height."""
        return self.specimen.height_mm

    @property
    def field(self) -> Field:
        """Even between sliding ends; bonded ones are taken as even, with the energy that the force has."""
        return "uniform"

    @property
    def yield_depth_mm(self) -> float | None:
        """Y/E of the height; bonded ends carry 1 + D/(3 root(3) H) times Y and are stiffer.

        Source: Johnson and Mellor, "Engineering Plasticity", 1973, sec. 6 (disc between rough dies).
        """
        if self.specimen.ends != "bonded":
            return self.length_mm
        carried = 1 + self.specimen.diameter_mm / (3 * np.sqrt(3) * self.length_mm)
        return float(self.length_mm * carried / self._ends_factor)

    @property
    def area_mm2(self) -> float:
        """Of an undeformed end."""
        return float(np.pi * self.specimen.diameter_mm**2 / 4)

    @property
    def toe_mm(self) -> float:
        """Of ends that are half a degree out of parallel."""
        return TOE_SHARE * self.specimen.diameter_mm

    def held_over_sliding(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"] | None:
        """Of the table, where the ends are not stated."""
        return None if self.specimen.ends is not None else self._held(depth_mm)

    def _held(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        if self.held_over_sliding_at is None:
            return np.ones(np.shape(depth_mm))
        strain = np.asarray(depth_mm) / self.length_mm
        first, end = self.held_over_sliding_at.x[[0, -1]]
        within = self.held_over_sliding_at(np.clip(strain, first, end))
        falls = float(self.held_over_sliding_at(end, 1) / (self.held_over_sliding_at(end) - 1))
        return np.asarray(1 + (within - 1) * np.exp(falls * np.maximum(strain - end, 0.0)))

    @property
    def _ends_factor(self) -> float:
        """Of stated ends, on the force at small strain."""
        return float(self._held(np.zeros(1))[0]) if self.specimen.ends == "bonded" else 1.0

    def force_N_per_MPa(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """phi(d): nothing out of contact; with sliding ends where they are not stated."""
        depth = np.asarray(np.maximum(depth_mm, 0.0))
        strain, end = depth / self.length_mm, self.sliding.x[-1]
        beyond = np.maximum(strain - end, 0.0) * self.sliding(end, 1)
        force = self.area_mm2 * (self.sliding(np.minimum(strain, end)) + beyond)
        return np.asarray(force * self._held(depth) if self.specimen.ends == "bonded" else force)

    def energy_strain(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Strain energy density over mu, of small strain: (1 + nu) e^2, times the ends' factor."""
        strain = np.maximum(depth_mm, 0.0) / self.length_mm
        return np.asarray((1 + self.poisson_ratio) * self._ends_factor * strain**2)

    def notes(self, deepest_mm: float) -> tuple[str, ...]:
        """Ranges left, and what ends do to E."""
        notes = []
        strain, trusted = deepest_mm / self.length_mm, TRUSTED_STRAIN[self.specimen.ends]
        if strain > trusted:
            notes.append(
                f"The specimen was squeezed by {strain:.0%} of its height, beyond the {trusted:.0%} that its "
                "law is held to."
            )
        if self.specimen.ends == "bonded":
            notes.append(
                f"Its ends are taken as held: if they slid, E would be {self._ends_factor:.2f} times as much."
            )
        elif self.specimen.ends == "lubricated":
            try:
                slender = self.length_mm / self.specimen.diameter_mm
                held = float(bonded_stress(slender, poisson_ratio=self.poisson_ratio)(0.0, 1))
                said = f"E would be {1 / held:.2f} times as much"
            except FemFailure:
                said = "E would be less"
            notes.append(f"Its ends are taken as sliding without friction: if they were held, {said}.")
        return tuple(notes)

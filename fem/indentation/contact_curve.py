"""Interface of the geometries of a press: force over depth for unit modulus, and strain of the flesh.

A `Geometry` holds the dimensions that the user states (a ball's radius, a fruit's diameters). Its
`ContactCurve` is the force-depth curve for one Poisson's ratio. Each geometry has its own file here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from fem.fem_failure import FemFailure, FemProblem

Field: TypeAlias = Literal["hertz", "uniform", "rim"]
"""Distribution of strain energy: as under a ball, uniform, or unbounded at a sharp rim."""
OfDepth: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""A function of depths (mm), of any shape."""
THICK = ("No thickness was given: a half-space was assumed, and a thin specimen looks stiffer.",)
"""Note on a press on a slab of unstated thickness."""


@dataclass(frozen=True, kw_only=True)
class ContactCurve:
    """Elastic force over depth of one geometry; the defaults are those of Hertz's field.

    `force_N_per_MPa`: for unit modulus, zero out of contact. `length_mm`: length that converts depth to
    strain. `over_half_space`: factor on Hertz's force by base, the body's other side or a pit. `trusted_mm`:
    depth up to which the law is valid. `beyond`: the sentence for a deeper press; its {} is the depth over
    `size_mm`. `notes`: sentences a reader must know in any case.
    `yield_depth_mm`: depth, per yield stress over E, at which all flesh under the tool flows; None if contact
    and flow grow together. `held_over_sliding`: force with bonded ends over that with sliding ends, if the
    ends are not stated. `stiffer_ends`: factor of stated ends on the force at small strain. `toe_mm`: typical
    spread of first touches of an end that is not parallel to its plate. `without`: effects that are not
    tested, since they have no law in this geometry or no signature of their own, and why, as the end of a
    sentence.
    """

    poisson_ratio: float
    length_mm: float
    force_N_per_MPa: OfDepth
    trusted_mm: float
    size_mm: float
    beyond: str
    notes: tuple[str, ...] = ()
    without: Mapping[str, str] = field(default_factory=dict)
    field: Field = "hertz"
    over_half_space: OfDepth = np.ones_like
    yield_depth_mm: float | None = None
    held_over_sliding: OfDepth | None = None
    stiffer_ends: float = 1.0
    toe_mm: float = 0.0

    def energy_strain(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Strain energy density over the shear modulus.

        In a uniform field (1 + nu) e^2 times the ends' factor. In Hertz's field in units of
        hertz_energy_density: it grows as (a/R)^2 = d/R and with the square of the pressure's factor.
        """
        depth = np.asarray(np.maximum(depth_mm, 0.0))
        strain = depth / self.length_mm
        if self.field == "uniform":
            return np.asarray((1 + self.poisson_ratio) * self.stiffer_ends * strain**2)
        return np.asarray(strain * self.over_half_space(depth) ** 2)

    def notes_of(self, deepest_mm: float) -> tuple[str, ...]:
        """Notes on a press to this depth."""
        too_deep = (self.beyond.format(deepest_mm / self.size_mm),) if deepest_mm > self.trusted_mm else ()
        return (*too_deep, *self.notes)


class Geometry(Protocol):
    """Tool and specimen of a press."""

    @property
    def tool(self) -> str:
        """ "ball", "punch" or "plate": the moving part, in sentences."""

    @property
    def said(self) -> str:
        """Tool and specimen in words, for reports."""

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> ContactCurve:
        """The curve; `thickness_mm` of a slab on a rigid base, None if it is thick compared with the dent.

        Raises FemFailure (bad-load) outside the curve's range.
        """


def out_of_range(fault: str, expected: str) -> FemFailure:
    """The failure (bad-load) of a geometry or curve outside the range of any law."""
    return FemFailure(FemProblem.BAD_LOAD, f"indenter trace: found {fault}, expected {expected}.")


def require_positive(name: str, value_mm: float, advice: str) -> None:
    """Raises FemFailure (bad-load) unless the length is positive and finite."""
    if not 0 < value_mm < np.inf:
        raise out_of_range(f"{name} {value_mm:g} mm", f"more than 0: {advice}")


def require_no_thickness(thickness_mm: float | None, instead: str) -> None:
    """Raises FemFailure (bad-load) if a slab's thickness is given for a specimen that is not a slab."""
    if thickness_mm is not None:
        raise out_of_range(
            f"thickness {thickness_mm:g} mm of a specimen between plates",
            f"none (it is a slab's under a ball or punch; {instead}): take it out",
        )


def tabulated(name: str) -> tuple[list[Float[np.ndarray, " _"]], Float[np.ndarray, "..."]]:
    """The axes of a table of finite-element results (all columns but the last), and the logarithms of its
    last column on this grid.
    """
    rows = np.genfromtxt(Path(__file__).parent / "tables" / name, delimiter=",", skip_header=1)
    axes = [np.unique(column) for column in rows[:, :-1].T]
    return axes, np.log(rows[:, -1]).reshape([len(axis) for axis in axes])


def near_incompressible(poisson_ratio: float | Float[np.ndarray, " n"]) -> Float[np.ndarray, "*n"]:
    """-ln(1 - 2 nu): near 1/2 thin flesh's stiffness depends on 1 - 2 nu, and tables are smooth in this."""
    return np.asarray(-np.log(np.maximum(1 - 2 * np.asarray(poisson_ratio), 1e-300)))


def straight_on(spline: CubicSpline, x: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
    """The spline, extrapolated linearly beyond its end."""
    end = spline.x[-1]
    return np.asarray(spline(np.minimum(x, end)) + np.maximum(x - end, 0.0) * spline(end, 1))

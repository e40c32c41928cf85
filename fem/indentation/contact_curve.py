"""What every geometry of a press answers: force over depth for unit modulus, and how flesh is strained by it.

A `Geometry` is what the person who recorded knows (a ball's radius, a fruit's diameters); its `ContactCurve`
is the force-depth curve that follows for one Poisson's ratio. Each geometry is one file beside this one.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Literal, Protocol, TypeAlias

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem

Field: TypeAlias = Literal["hertz", "uniform", "rim"]
"""How strain energy is spread: as under a ball, evenly, or without bound at a sharp rim."""
THICK = "No thickness was given: a half-space was assumed, and a thin specimen looks stiffer."


class ContactCurve(ABC):
    """Elastic force over depth of one geometry, for unit modulus; the defaults are those of Hertz's field."""

    poisson_ratio: float

    @property
    @abstractmethod
    def length_mm(self) -> float:
        """What depth is divided by to be a strain of the flesh."""

    @property
    def field(self) -> Field:
        """Where the flesh is strained."""
        return "hertz"

    @property
    def yield_depth_mm(self) -> float | None:
        """Depth, per yield stress over E, at which flesh flows everywhere under the tool; None where contact
        grows with depth and flow with it.
        """
        return None

    @property
    def without(self) -> Mapping[str, str]:
        """Effects that have no law in this geometry, and why not, as the end of a sentence."""
        return {}

    @property
    def toe_mm(self) -> float:
        """Typical width of the first touches of an end that is not quite parallel to its plate; 0: the tool
        touches at a point.
        """
        return 0.0

    def held_over_sliding(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"] | None:
        """Force with held ends over that with sliding ends; None where the ends are known or absent."""
        del depth_mm
        return None

    @abstractmethod
    def force_N_per_MPa(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """phi(d): nothing out of contact."""

    def over_half_space(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Factor on Hertz's force by what is not a half-space: base, the body's other side, a pit."""
        return np.ones(np.shape(depth_mm))

    def energy_strain(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Strain energy density over the shear modulus: of an even field itself, of Hertz's in units of
        hertz_energy_density. There it grows as (a/R)^2 = d/R and with the square of the pressure's factor.
        """
        depth = np.asarray(np.maximum(depth_mm, 0.0))
        return np.asarray(depth / self.length_mm * self.over_half_space(depth) ** 2)

    @abstractmethod
    def notes(self, deepest_mm: float) -> tuple[str, ...]:
        """What a reader must know of a press so deep: ranges left, what was assumed."""


class Geometry(Protocol):
    """What presses on what."""

    @property
    def tool(self) -> str:
        """ "ball", "punch" or "plate": the moving part, in sentences."""

    @property
    def said(self) -> str:
        """Tool and specimen in words, for reports."""

    def curve(self, *, thickness_mm: float | None, poisson_ratio: float) -> ContactCurve:
        """The curve; `thickness_mm` of a slab on a rigid base, None where it is thick against the dent.

        Raises FemFailure (bad-load) outside of the curve's range.
        """


def out_of_range(fault: str, expected: str) -> FemFailure:
    """The failure (bad-load) of a geometry or trace that no law holds for."""
    return FemFailure(FemProblem.BAD_LOAD, f"indenter trace: found {fault}, expected {expected}.")


def require_positive(name: str, value_mm: float, advice: str) -> None:
    """Raises FemFailure (bad-load) unless the length is more than nothing."""
    if not 0 < value_mm < np.inf:
        raise out_of_range(f"{name} {value_mm:g} mm", f"more than 0: {advice}")


def require_no_thickness(thickness_mm: float | None, instead: str) -> None:
    """Raises FemFailure (bad-load) where a slab's thickness is given of a specimen that is no slab."""
    if thickness_mm is not None:
        raise out_of_range(
            f"thickness {thickness_mm:g} mm of a specimen between plates",
            f"none (it is a slab's under a ball or punch; {instead}): take it out",
        )

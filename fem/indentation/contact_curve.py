"""What every geometry of a press answers: force over depth for unit modulus, and how flesh is strained by it.

A `Geometry` is what the person who recorded knows (a ball's radius, a fruit's diameters); its `ContactCurve`
is the force-depth curve that follows for one Poisson's ratio. Each geometry is one file beside this one.
"""

from collections.abc import Mapping
from typing import Literal, Protocol, TypeAlias

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem

Field: TypeAlias = Literal["hertz", "uniform", "rim"]
"""How strain energy is spread: as under a ball, evenly, or without bound at a sharp rim."""


class ContactCurve(Protocol):
    """Elastic force over depth of one geometry, for unit modulus; every effect of a trace is said by it."""

    @property
    def poisson_ratio(self) -> float:
        """Of the flesh."""

    @property
    def length_mm(self) -> float:
        """What depth is divided by to be a strain of the flesh."""

    @property
    def field(self) -> Field:
        """Where the flesh is strained."""

    @property
    def yield_depth_mm(self) -> float | None:
        """Depth, per yield stress over E, at which flesh flows everywhere under the tool; None where contact
        grows with depth and flow with it (field "hertz").
        """

    @property
    def without(self) -> Mapping[str, str]:
        """Effects that have no law in this geometry, and why not, as the end of a sentence."""

    @property
    def shape_sd(self) -> float:
        """Relative standard deviation of E from the geometry alone: what closed form or table err by."""

    @property
    def toe_mm(self) -> float:
        """Typical width of the first touches of an end that is not quite parallel to its plate; 0: the tool
        touches at a point.
        """

    def held_over_sliding(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"] | None:
        """Force with held ends over that with sliding ends; None where the ends are known or absent."""

    def force_N_per_MPa(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """phi(d): nothing out of contact."""

    def energy_strain(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Strain energy density over the shear modulus: of an even field itself, of Hertz's in units of
        hertz_energy_density.
        """

    def over_half_space(self, depth_mm: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Factor on the force by what is not a half-space: base, ends, the body's other side, a pit."""

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


def require_positive(name: str, value_mm: float, advice: str) -> None:
    """Raises FemFailure (bad-load) unless the length is more than nothing."""
    if not 0 < value_mm < np.inf:
        raise FemFailure(
            FemProblem.BAD_LOAD,
            f"indenter trace: found {name} {value_mm:g} mm, expected more than 0: {advice}.",
        )


def require_no_thickness(thickness_mm: float | None, instead: str) -> None:
    """Raises FemFailure (bad-load) where a slab's thickness is given of a specimen that is no slab."""
    if thickness_mm is not None:
        raise FemFailure(
            FemProblem.BAD_LOAD,
            f"indenter trace: found thickness {thickness_mm:g} mm of a specimen between plates, expected "
            f"none (it is a slab's under a ball or punch; {instead}): take it out.",
        )

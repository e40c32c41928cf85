"""Variants: the alternative signatures of one effect.

A start value is rounded, so that rounding errors of a machine do not change the path of the search.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

Way: TypeAlias = tuple[str, bool | None]
"""A pad, empty for none, and whether a loose pit turns."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """`label`: in words. `pad`: the pad that has the effect; empty if no single pad has. `values`: parameters
    from which the search starts. `pit_turns`: whether a loose pit turns; None: not stated.
    """

    label: str = ""
    pad: str = ""
    values: tuple[float, ...] = ()
    pit_turns: bool | None = None

    @property
    def way(self) -> Way:
        """The part that a search fixes: its pad, and whether a loose pit turns."""
        return self.pad, self.pit_turns


ONE_WAY = Variant()
"""Variant of an effect with one signature only."""


def of_pad(pad: str) -> Variant:
    """Variant of one pad that has the effect."""
    return Variant(label=pad, pad=pad)


def at_value(symbol: str, value: float, unit: str = "") -> Variant:
    """Variant at one value of a parameter.

    >>> at_value("tau", 1.0, "s").label
    'tau 1 s'
    """
    return Variant(label=f"{symbol} {value:g} {unit}".rstrip(), values=(value,))


def at_place(centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> Variant:
    """Variant in a ball in the fruit; its place and radius are rounded to 0.01 mm."""
    x, y, z, radius = (round(float(value), 2) for value in (*centre_mm, radius_mm))
    label = f"{x:.2f} {y:.2f} {z:.2f} radius {radius:.2f} mm"
    return Variant(label=label, values=(x, y, z, radius))


def significant(value: float, digits: int) -> float:
    """The value rounded to this number of significant digits.

    >>> significant(0.0012345, 3)
    0.00123
    """
    return float(f"{value:.{digits}g}")

"""Which of an effect's ways to show a signature is.

A start value is rounded, so that the last bits of a machine's arithmetic do not send the search another way.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class Variant:
    """`label`: in words. `pad`: the one that has the effect; empty: none has. `values`: of parameters, from
    which the search starts. `pit_turns`: whether a loose pit turns; None: not said.
    """

    label: str = ""
    pad: str = ""
    values: tuple[float, ...] = ()
    pit_turns: bool | None = None


ONE_WAY = Variant()
"""Of an effect that shows in one way only."""


def of_pad(pad: str) -> Variant:
    """One pad has the effect."""
    return Variant(label=pad, pad=pad)


def at_value(symbol: str, value: float, unit: str = "") -> Variant:
    """One of the effect's parameters is at a value.

    >>> at_value("tau", 1.0, "s").label
    'tau 1 s'
    """
    return Variant(label=f"{symbol} {value:g} {unit}".rstrip(), values=(value,))


def at_place(centre_mm: Float[np.ndarray, "3"], radius_mm: float) -> Variant:
    """The effect is in a ball somewhere in the fruit, to a hundredth of a millimetre."""
    x, y, z, radius = (round(float(value), 2) for value in (*centre_mm, radius_mm))
    label = f"{x:.2f} {y:.2f} {z:.2f} radius {radius:.2f} mm"
    return Variant(label=label, values=(x, y, z, radius))


def significant(value: float, digits: int) -> float:
    """Rounded to so many significant digits.

    >>> significant(0.0012345, 3)
    0.00123
    """
    return float(f"{value:.{digits}g}")

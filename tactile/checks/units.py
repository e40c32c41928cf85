"""Which unit or constant a factor looks like."""

from collections.abc import Mapping

import numpy as np

SIMILAR = 0.12
"""Natural logarithm within which a factor counts as a unit's: gains of sound recordings spread by 0.05."""
FORCE = {
    101.97: "grams",
    0.10197: "kilograms",
    1e3: "millinewtons",
    1e-3: "kilonewtons",
    0.22481: "pounds",
    3.5969: "ounces",
    1e5: "dynes",
    1e6: "micronewtons",
}
"""What a number in newtons becomes in another unit, times."""
LENGTH = {1e-3: "metres", 0.1: "centimetres", 1e3: "micrometres", 1 / 25.4: "inches"}
"""The same of a number in millimetres."""
STIFFNESS = {1e3: "kPa/mm (or MPa/m)", 1e6: "Pa/mm", 1e-3: "GPa/mm"}
"""The same of a number in MPa/mm."""


def unit_like(factor: float, units: Mapping[float, str]) -> str | None:
    """The unit whose factor this is, if it is one's.

    >>> unit_like(103.0, FORCE), unit_like(2.0, FORCE)
    ('grams', None)
    """
    if not factor > 0:
        return None
    apart = {name: abs(float(np.log(factor / times))) for times, name in units.items()}
    name = min(apart, key=lambda one: apart[one])
    return name if apart[name] < SIMILAR else None


def times_said(factor: float) -> str:
    """A factor in words.

    >>> times_said(102.3), times_said(0.5), times_said(0.00098)
    ('102 times', '0.50 times', '1/1020 of')
    """
    if factor < 0.05:
        return f"1/{1 / factor:.0f} of"
    return f"{factor:.0f} times" if factor >= 20 else f"{factor:.2f} times"

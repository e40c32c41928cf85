"""What a whole fruit of a category can be at all: outside these ranges a number is a slip, no fruit."""

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields

Range = tuple[float, float]
MOST = 1e9
"""In any unit of a range: larger numbers are slips."""


@dataclass(frozen=True, kw_only=True)
class Plausible:
    """The least and the greatest value of each number that a real fruit of the category has; None: unknown.

    Wide on purpose: a value outside is refused, so no real fruit may lie there. `height_mm` is along the stem
    axis, `diameter_mm` across it; `density_g_per_cm3` is mass over the ellipsoid of height and diameter,
    which a flat or grooved fruit does not fill or overfills; `E_MPa` is Young's modulus of the flesh, from
    over-ripe to unripe.
    """

    height_mm: Range | None = None
    diameter_mm: Range | None = None
    mass_g: Range | None = None
    shore_oo: Range | None = None
    penetrometer_N: Range | None = None
    density_g_per_cm3: Range | None = None
    E_MPa: Range | None = None


def read_plausible(table: object, *, refuse: Callable[[str], Exception]) -> Plausible | None:
    """The table [plausible] of a category's file, each entry `[low, high]`; None where there is no table.

    Raises what `refuse` makes of a sentence: for a key that is not known, or no two rising numbers above 0.
    """
    if table is None:
        return None
    if not isinstance(table, dict):
        raise refuse(f"plausible is {str(table)[:60]}; expected a table [plausible] of ranges [low, high].")
    known = [field.name for field in fields(Plausible)]
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}."
            raise refuse(f'unknown key "plausible.{key}"; {hint}')
        fits = isinstance(value, list) and len(value) == 2 and all(map(is_number, value))
        if not (fits and 0 <= value[0] < value[1] < MOST):
            raise refuse(
                f"plausible.{key} is {str(value)[:60]}; expected [low, high]: two numbers of 0 or above, the "
                "smaller first."
            )
    return Plausible(**{key: (float(low), float(high)) for key, (low, high) in table.items()})


def is_number(value: object) -> bool:
    """Whether it is a finite number, and no true or false."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)

"""What a whole fruit of a category can be at all: outside these ranges a number is a slip, no fruit."""

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields

Range = tuple[float, float]


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
    known = [one.name for one in fields(Plausible)]
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}."
            raise refuse(f'unknown key "plausible.{key}"; {hint}')
        if not _is_range(value):
            raise refuse(
                f"plausible.{key} is {str(value)[:60]}; expected [low, high]: two numbers of 0 or above, the "
                "smaller first."
            )
    return Plausible(**{key: (float(low), float(high)) for key, (low, high) in table.items()})


def _is_range(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e9 for v in value)
        and all(map(math.isfinite, value))
        and 0 <= value[0] < value[1]
    )

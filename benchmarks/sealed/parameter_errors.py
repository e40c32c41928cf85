"""An effect's parameters against the true ones: relative errors, and whether 90 % intervals hold them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fem.mismatch.catalogue import SPECS

NINETY = 1.645
"""Standard deviations that hold 90 % of a normal distribution on either side."""
PLACES = ("centre_mm",)
"""Parameters whose size is where they count from: not scored by relative error."""


@dataclass(frozen=True, kw_only=True)
class ParameterError:
    """`error`: relative, with its sign; of a vector the error's length over the truth's; None of a word.

    `inside`: of each component; empty where no interval was said.
    """

    name: str
    value: Any
    truth: Any
    error: float | None
    inside: tuple[bool, ...]


def parameter_errors(
    effects: Sequence[str], said: Mapping[str, Mapping[str, Any]], true: Mapping[str, Any]
) -> list[ParameterError]:
    """Of each parameter that formats define and both have, by "effect.name".

    `said`: value, sd and interval (either may be None) by name; `true`: values by name. Of several effects
    names begin with the effect's own and a point, in both.
    """
    errors = []
    for effect in effects:
        for spec in SPECS[effect].parameters if effect in SPECS else ():
            key = f"{effect}.{spec.name}" if len(effects) > 1 else spec.name
            if key in said and key in true and spec.name not in PLACES:
                errors.append(_compared(f"{effect}.{spec.name}", said[key], true[key]))
    return errors


def _compared(name: str, said: Mapping[str, Any], truth: Any) -> ParameterError:
    if isinstance(truth, str):
        return ParameterError(name=name, value=said["value"], truth=truth, error=None, inside=())
    value, wanted = (np.atleast_1d(np.array(x, dtype=float)) for x in (said["value"], truth))
    size = max(float(np.linalg.norm(wanted)), np.finfo(float).tiny)
    off = float(np.linalg.norm(value - wanted)) / size
    if said["interval"] is not None:
        low, high = said["interval"]
        inside = (bool(low <= wanted[0] <= high),)
    elif said["sd"] is not None:
        spread = NINETY * np.atleast_1d(np.array(said["sd"], dtype=float))
        inside = tuple(bool(x) for x in np.abs(value - wanted) <= spread)
    else:
        inside = ()
    return ParameterError(
        name=name,
        value=said["value"],
        truth=truth,
        error=-off if len(value) == 1 and value[0] < wanted[0] else off,
        inside=inside,
    )

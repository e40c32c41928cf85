"""An effect in a force-displacement curve: its unknowns, and how it changes the force.

Names, units, words and scope are those of the same effect between pads, which defines them
(fem.mismatch.effects).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.trace import IndenterTrace
from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.result import NINETY, Parameter

Values: TypeAlias = Mapping[str, Float[np.ndarray, " p"]]
"""Unknowns by name, one number for each of p rows that are evaluated together."""
Rows: TypeAlias = Float[np.ndarray, "p _"]
"""Numbers for these rows in each frame, or at each of their springs' levels."""


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A number whose `scale` (log: positive, logit: between 0 and 1) is normal with `mean` and `sd`."""

    name: str
    unit: str
    scale: Literal["linear", "log", "logit"]
    mean: float
    sd: float

    def value(self, scaled: Float[np.ndarray, " *p"]) -> Float[np.ndarray, " *p"]:
        """The number itself."""
        if self.scale == "linear":
            return np.asarray(scaled)
        return np.asarray(np.exp(scaled) if self.scale == "log" else 1 / (1 + np.exp(-scaled)))

    def parameter(self, scaled: float, sd: float) -> Parameter:
        """Value with standard deviation (to first order) and the 90 % interval carried from the scale."""
        low, value, high = (float(self.value(np.array(scaled + k * sd))) for k in (-NINETY, 0, NINETY))
        slope = {"linear": 1.0, "log": value, "logit": value * (1 - value)}[self.scale]
        return Parameter(value=value, sd=slope * sd, unit=self.unit, interval=(low, high))


@dataclass(frozen=True, kw_only=True)
class TraceEffect:
    """One effect in one of its forms (the number of relaxing arms is a form, not an effect).

    Its changes of the force (fem.indentation.contact_law), each None if absent. `give_mm`: displacement of
    the machine, subtracted from the travel; `stress_factor`: on the force at a level; `slack_mm`: of each
    spring at each level; `relaxation`: shares and times (s) of its arms; `force_factor`: at a depth after
    the deepest; `added_N`: to the recorded force. `parameters`: converts unknowns that are not the reported
    parameters, from their values on their scales and the covariance of these.
    """

    name: str
    unknowns: tuple[Unknown, ...]
    give_mm: Callable[[Values, IndenterTrace], Rows] | None = None
    stress_factor: Callable[[Values, ContactCurve, Rows], Rows] | None = None
    slack_mm: Callable[[Values, ContactCurve, Rows, Rows], Float[np.ndarray, "p t n"]] | None = None
    relaxation: Callable[[Values], tuple[Float[np.ndarray, "k p"], Float[np.ndarray, "k p"]]] | None = None
    force_factor: Callable[[Values, ContactCurve, Rows, Rows], Rows] | None = None
    added_N: Callable[[Values, IndenterTrace], Rows] | None = None
    parameters: Callable[[np.ndarray, np.ndarray], dict[str, Parameter]] | None = None


def unknown(
    spec: EffectSpec, name: str, *, scale: Literal["linear", "log", "logit"], mean: float, sd: float
) -> Unknown:
    """A parameter of the effect as a curve's unknown, in its unit; raises KeyError if there is none."""
    parameter = spec.parameter(name)
    if parameter is None:
        raise KeyError(name)
    return Unknown(name=name, unit=parameter.unit, scale=scale, mean=mean, sd=sd)

"""What an effect is to the finder in a bare indenter's trace: its unknowns, and how it changes the force.

Every file of fem/indentation/effects holds one TraceEffectSpec as EFFECT. Names, units, words and scope are
those of the same effect between pads (fem.mismatch.effects), said there once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from fem.indentation.contact_curve import ContactCurve
from fem.indentation.trace import IndenterTrace
from fem.indentation.unknowns import Unknown
from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.result import Parameter

Values: TypeAlias = Mapping[str, Float[np.ndarray, " p"]]
"""Unknowns by name, one number for each of p rows that are tried at once."""


@dataclass(frozen=True, kw_only=True)
class TraceEffect:
    """One missing physics, in one of its forms (the number of relaxing arms is a form, not an effect).

    How it changes the force (fem.indentation.contact_law), each None where it does not: `give_mm` of the
    machine, taken off the travel; `stress_factor` on the force at a level; `slack_mm` of each spring at
    each level; `relaxation`: shares and times (s) of its arms; `force_factor` at a depth after the
    deepest; `added_N` to the recorded force. `parameters`: what is reported of unknowns that are not the
    parameters themselves, from their values on their scales and the covariance of these.
    """

    name: str
    unknowns: tuple[Unknown, ...]
    arms: int = 0
    give_mm: Callable[[Values, IndenterTrace], Float[np.ndarray, "p t"]] | None = None
    stress_factor: Callable[[Values, ContactCurve, np.ndarray], Float[np.ndarray, "p n"]] | None = None
    slack_mm: Callable[[Values, ContactCurve, np.ndarray, np.ndarray], Float[np.ndarray, "p t n"]] | None = (
        None
    )
    relaxation: Callable[[Values], tuple[Float[np.ndarray, "k p"], Float[np.ndarray, "k p"]]] | None = None
    force_factor: (
        Callable[[Values, ContactCurve, np.ndarray, np.ndarray], Float[np.ndarray, "p t"]] | None
    ) = None
    added_N: Callable[[Values, IndenterTrace], Float[np.ndarray, "p t"]] | None = None
    parameters: Callable[[np.ndarray, np.ndarray], dict[str, Parameter]] | None = None


@dataclass(frozen=True, kw_only=True)
class TraceEffectSpec:
    """An effect of traces: what it says of itself between pads, its place in the search (which decides what
    is drawn for it), and its forms in a trace, simplest first.
    """

    spec: EffectSpec
    rank: int
    forms: Callable[[IndenterTrace], tuple[TraceEffect, ...]]


def unknown(
    spec: EffectSpec, name: str, *, scale: Literal["linear", "log", "logit"], mean: float, sd: float
) -> Unknown:
    """A parameter of the effect as a trace's unknown, in its unit; raises KeyError where it has none such."""
    parameter = spec.parameter(name)
    if parameter is None:
        raise KeyError(name)
    return Unknown(name=name, unit=parameter.unit, scale=scale, mean=mean, sd=sd)

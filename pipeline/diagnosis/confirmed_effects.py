"""Effects that a batch's settings hold as confirmed: `[[mismatch]]` in batch.toml, which grading uses."""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from fem.elements.assembly import LARGEST_POISSON_RATIO
from recon.plain_file import printable
from tactile.correction import (
    ComplianceFault,
    DriftFault,
    Fault,
    GainFault,
    LagFault,
    PoseFault,
)

Kind = Literal["number", "pair", "triple", "pad"]
Value = float | tuple[float, ...] | str
PARAMETERS: dict[str, dict[str, Kind]] = {
    "viscoelastic": {"g": "number", "tau_s": "number"},
    "stiffening": {"b": "number"},
    "skin": {"Et_N_per_mm": "number"},
    "graded_modulus": {"gamma": "number"},
    "soft_spot": {"centre_mm": "triple", "radius_mm": "number", "ratio": "number"},
    "anisotropy": {"axial": "number"},
    "poisson_ratio": {"nu": "number"},
    "pit_offset": {"offset_mm": "triple"},
    "pit_size": {"scale": "number"},
    "loose_pit": {"gap_mm": "number"},
    "slip": {"mu": "number"},
    "plastic_set": {"yield_over_E": "number"},
    "damage": {"dmax": "number", "W0_over_E": "number"},
    "sensor_gain": {"pad": "pad", "gain": "number"},
    "sensor_drift": {"pad": "pad", "newton_per_s": "number"},
    "gripper_compliance": {"mm_per_N": "number"},
    "clock_lag": {"lag_s": "number"},
    "pose_error": {"pad": "pad", "shift_mm": "pair", "tilt_deg": "number"},
}
"""Every effect that can be confirmed, and the parameters that it needs; docs/formats.md defines them."""
LIMITS: dict[str, tuple[float, float]] = {
    "g": (0.0, 1.0), "tau_s": (1e-6, 1e6), "b": (-10.0, 1e3), "Et_N_per_mm": (0.0, 1e4), "gamma": (-1.0, 1.0),
    "centre_mm": (-1e3, 1e3), "radius_mm": (1e-3, 1e3), "ratio": (1e-6, 1e6), "axial": (-10.0, 1e3),
    "nu": (0.0, LARGEST_POISSON_RATIO), "offset_mm": (-100.0, 100.0), "scale": (0.01, 100.0),
    "gap_mm": (0.0, 50.0), "mu": (0.0, 100.0), "yield_over_E": (0.0, 1e3), "dmax": (0.0, 1.0),
    "W0_over_E": (0.0, 1e6), "gain": (0.01, 100.0), "newton_per_s": (-1e3, 1e3), "mm_per_N": (-10.0, 10.0),
    "lag_s": (-100.0, 100.0), "shift_mm": (-100.0, 100.0), "tilt_deg": (-90.0, 90.0),
}  # fmt: skip
"""What a parameter can be at all, wide: what was found may be far from usual."""
MOST_SD = 1e6
"""In the parameter's own unit: above every range in LIMITS, so that only slips and infinities are refused."""
OF_THE_JAWS = frozenset({"sensor_gain", "sensor_drift", "gripper_compliance", "clock_lag", "pose_error"})
"""Faults of the measurement: they hold for every fruit of a batch, and are taken out of its recordings."""
OF_ONE_FRUIT = frozenset({"soft_spot", "pit_offset", "pit_size", "loose_pit"})
"""What one fruit has and its neighbour has not; the rest of the effects are the lot's."""
_ARMS = re.compile(r"(g_\d+|tau_\d+_s)\Z")
_LENGTH = {"pair": 2, "triple": 3}
"""Numbers in a list of this kind: a shift on the pad's face, a place in the fruit."""


class ConfirmedEffect(BaseModel):
    """One effect, its parameters and their standard deviations; `fruits`: only these, else all."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    effect: Annotated[str, Field(max_length=100)]
    parameters: Annotated[dict[str, Value], Field(max_length=100)]
    sd: Annotated[dict[str, float | tuple[float, ...]], Field(max_length=100)] = {}
    fruits: tuple[str, ...] | None = None
    found_in: Annotated[str, Field(max_length=10_000)] | None = None
    probability: Annotated[float, Field(ge=0, le=1)] | None = None

    @field_validator("found_in", mode="before")
    @classmethod
    def _printable(cls, value: Any) -> Any:
        return printable(value) if isinstance(value, str) else value

    @field_validator("parameters", "sd", mode="before")
    @classmethod
    def _numbers(cls, held: Any) -> Any:
        for name, value in held.items() if isinstance(held, dict) else ():
            if isinstance(value, bool):
                raise ValueError(f"{name} is {str(value).lower()}, expected a number")
        return held

    @field_validator("effect")
    @classmethod
    def _known(cls, effect: str) -> str:
        if effect not in PARAMETERS:
            near = difflib.get_close_matches(effect, PARAMETERS, n=1)
            hint = f'did you mean "{near[0]}"?' if near else f"known effects: {', '.join(PARAMETERS)}"
            raise ValueError(f"no effect that grading knows; {hint}")
        return effect

    @model_validator(mode="after")
    def _complete(self) -> Self:
        wanted = PARAMETERS[self.effect]
        for name, kind in wanted.items():
            if name not in self.parameters:
                raise ValueError(f"{self.effect} needs the parameter {name}, found {sorted(self.parameters)}")
            _require(name, self.parameters[name], kind)
        for name in self.parameters.keys() - wanted.keys():
            if self.effect != "viscoelastic" or not _ARMS.match(name):
                raise ValueError(f'{self.effect} has no parameter "{name}"; it has {", ".join(wanted)}')
            _require(name, self.parameters[name], "number")
        for name in self.sd:
            if name not in self.parameters or wanted.get(name) == "pad":
                raise ValueError(f'sd has "{name}", which is no number among the parameters')
            spread = self.spread(name)
            if not 0 <= spread <= MOST_SD:
                raise ValueError(f"sd.{name} is {spread:g}, expected 0 or more and at most {MOST_SD:g}")
        for name in ("gain", "scale"):
            if name in wanted and not self.number(name) > 0:
                raise ValueError(f"{name} is {self.number(name):g}, expected above zero")
        return self

    def number(self, name: str) -> float:
        """A scalar parameter."""
        value = self.parameters[name]
        if not isinstance(value, int | float):
            raise TypeError(name)
        return float(value)

    def vector(self, name: str) -> tuple[float, ...]:
        """A parameter with several components."""
        value = self.parameters[name]
        if not isinstance(value, tuple):
            raise TypeError(name)
        return value

    def spread(self, name: str) -> float:
        """Standard deviation of a parameter, of a vector its longest; 0 where it is not known."""
        sd = self.sd.get(name, 0.0)
        return max(sd) if isinstance(sd, tuple) else float(sd)

    @property
    def pad(self) -> str:
        """The pad that the effect is about; empty where it is about none."""
        return str(self.parameters.get("pad", ""))

    def place(self) -> tuple[str, str, tuple[str, ...] | None]:
        """Two entries of the same place speak of the same thing: the later one replaces the earlier."""
        return (self.effect, self.pad, self.fruits)


def _require(name: str, value: Value, kind: Kind) -> None:
    if kind == "pad":
        right = isinstance(value, str) and value in ("left", "right", "tip")
        wanted = "left, right or tip"
    elif kind == "number":
        right = isinstance(value, int | float) and not isinstance(value, bool)
        wanted = "a number"
    else:
        right = isinstance(value, tuple) and len(value) == _LENGTH[kind]
        wanted = f"{_LENGTH[kind]} numbers"
    if not right:
        raise ValueError(f"{name} is {value!r:.80}, expected {wanted}")
    low, high = LIMITS.get(name) or LIMITS["g" if name.startswith("g_") else "tau_s"]
    numbers = () if isinstance(value, str) else value if isinstance(value, tuple) else (value,)
    if not all(low <= one <= high for one in numbers):
        raise ValueError(f"{name} is {value!r:.80}, expected {low:g} to {high:g}")


@dataclass(frozen=True, kw_only=True)
class PitFound:
    """Where and how large the pit was found to be against its prior; spreads 0 where nothing was found."""

    offset_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    offset_sd_mm: float = 0.0
    scale: float = 1.0
    size_sd: float = 0.0

    def moved(self, pit_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The prior's or a given pit, put where it was found and of the size found."""
        middle = (pit_mm.min(axis=0) + pit_mm.max(axis=0)) / 2
        return np.asarray(middle + self.offset_mm + self.scale * (pit_mm - middle))


def pit_found(effects: Iterable[ConfirmedEffect]) -> PitFound:
    """What the effects say of the pit."""
    found = PitFound()
    for one in effects:
        if one.effect == "pit_offset":
            found = replace(found, offset_mm=one.vector("offset_mm"), offset_sd_mm=one.spread("offset_mm"))
        if one.effect == "pit_size":
            scale = one.number("scale")
            found = replace(found, scale=scale, size_sd=one.spread("scale") / scale)
    return found


def effects_on(effects: Iterable[ConfirmedEffect], fruit_id: str) -> tuple[ConfirmedEffect, ...]:
    """Those that hold for one fruit."""
    return tuple(one for one in effects if one.fruits is None or fruit_id in one.fruits)


def faults(effects: Iterable[ConfirmedEffect]) -> tuple[Fault, ...]:
    """The jaws' faults among the effects, to be taken out of every recording."""
    return tuple(_fault(one) for one in effects if one.effect in OF_THE_JAWS)


def _fault(one: ConfirmedEffect) -> Fault:
    if one.effect == "sensor_gain":
        return GainFault(pad=one.pad, gain=one.number("gain"))
    if one.effect == "sensor_drift":
        return DriftFault(pad=one.pad, newton_per_s=one.number("newton_per_s"))
    if one.effect == "gripper_compliance":
        return ComplianceFault(mm_per_N=one.number("mm_per_N"))
    if one.effect == "clock_lag":
        return LagFault(lag_s=one.number("lag_s"))
    x, y = one.vector("shift_mm")
    return PoseFault(pad=one.pad, shift_mm=(x, y), tilt_deg=one.number("tilt_deg"))


def in_words(effects: Iterable[ConfirmedEffect]) -> str:
    """Names as the ranking's `mismatch` column has them: sorted, joined by "+"."""
    return "+".join(sorted({one.effect for one in effects}))


def keyed(effects: Iterable[ConfirmedEffect]) -> list[dict[str, Any]]:
    """What a fruit's result depends on: not who found it, nor how sure it was."""
    return [one.model_dump(mode="json", include={"effect", "parameters", "sd"}) for one in effects]

"""Confirmed effects in a batch's settings (`[[mismatch]]` in batch.toml), which grading includes in E."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Self

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, Entry
from pipeline.files.plain_file import printable
from pipeline.problem import nearest
from tactile.correction import (
    ComplianceFault,
    DriftFault,
    Fault,
    ForceLawFault,
    GainFault,
    GelCreepFault,
    GelHysteresisFault,
    LagFault,
    PoseFault,
    ThermalFault,
)

Value = float | tuple[float, ...] | str
MOST_SD = 1e6
"""Largest sd, in the parameter's unit: above all limits, to refuse only typing errors and infinities."""
_LENGTH = {"pair": 2, "triple": 3}
"""Numbers of a parameter by its kind: 2 for a shift on the pad's face, 3 for a place in the fruit."""


class ConfirmedEffect(BaseModel):
    """One effect, its parameters and their standard deviations; `fruits`: ids it applies to (None: all)."""

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
        if effect not in SPECS:
            hint = nearest(effect, SPECS, f"known effects: {', '.join(SPECS)}")
            raise ValueError(f"grading knows no such effect; {hint}")
        return effect

    @model_validator(mode="after")
    def _complete(self) -> Self:
        """Raises ValueError if a parameter of the effect or its sd is missing, unknown or implausible."""
        for parameter in self.spec.parameters:
            name = parameter.name
            if name not in self.parameters:
                raise ValueError(f"{self.effect} needs the parameter {name}, found {sorted(self.parameters)}")
            _require(name, self.parameters[name], parameter)
        wanted = {parameter.name: parameter for parameter in self.spec.parameters}
        for name in self.parameters.keys() - wanted.keys():
            known = self.spec.parameter(name)
            if known is None:
                raise ValueError(f'{self.effect} has no parameter "{name}"; it has {", ".join(wanted)}')
            _require(name, self.parameters[name], known)
        for name in self.sd:
            if name not in self.parameters or isinstance(self.parameters[name], str):
                raise ValueError(
                    f'sd has the key "{name}", but the effect has no numeric parameter of that name'
                )
            spread = self.spread(name)
            if not 0 <= spread <= MOST_SD:
                raise ValueError(f"sd.{name} is {spread:g}, expected 0 to {MOST_SD:g}")
        return self

    @property
    def spec(self) -> EffectSpec:
        """The effect's entry in the catalogue."""
        return SPECS[self.effect]

    def number(self, name: str) -> float:
        """A scalar parameter; raises TypeError if it is no number."""
        value = self.parameters[name]
        if not isinstance(value, int | float):
            raise TypeError(name)
        return float(value)

    def vector(self, name: str) -> tuple[float, ...]:
        """A parameter with several components; raises TypeError if it has only one."""
        value = self.parameters[name]
        if not isinstance(value, tuple):
            raise TypeError(name)
        return value

    def spread(self, name: str) -> float:
        """Standard deviation of a parameter, of a vector the largest component; 0 if unknown."""
        sd = self.sd.get(name, 0.0)
        return max(sd) if isinstance(sd, tuple) else float(sd)

    @property
    def pad(self) -> str:
        """The pad that the effect concerns; empty if it concerns none."""
        return str(self.parameters.get("pad", ""))

    def place(self) -> tuple[str, str, tuple[str, ...] | None]:
        """Effect, pad and fruits. Two entries with the same place describe the same thing."""
        return (self.effect, self.pad, self.fruits)


def _require(name: str, value: Value, parameter: EffectParameter) -> None:
    """Raises ValueError for a value of another kind than the parameter's, or outside its limits."""
    kind, (low, high) = parameter.kind, parameter.limits
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
    numbers = () if isinstance(value, str) else value if isinstance(value, tuple) else (value,)
    if not all(low <= number <= high for number in numbers):
        raise ValueError(f"{name} is {value!r:.80}, expected {low:g} to {high:g}")


@dataclass(frozen=True, kw_only=True)
class PitFound:
    """Offset and scale of the pit against its prior, with standard deviations (`size_sd` relative). The
    standard deviations are 0 if no confirmed effect concerns the pit.
    """

    offset_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    offset_sd_mm: float = 0.0
    scale: float = 1.0
    size_sd: float = 0.0

    def moved(self, pit_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The pit's vertices (mm), scaled by `scale` about their box's middle and moved by `offset_mm`."""
        middle = (pit_mm.min(axis=0) + pit_mm.max(axis=0)) / 2
        return np.asarray(middle + self.offset_mm + self.scale * (pit_mm - middle))


def pit_found(effects: Iterable[ConfirmedEffect]) -> PitFound:
    """Offset and size of the pit according to the effects."""
    pit = PitFound()
    for effect in effects:
        if effect.spec.correction is Correction.PIT_OFFSET:
            pit = replace(pit, offset_mm=effect.vector("offset_mm"), offset_sd_mm=effect.spread("offset_mm"))
        if effect.spec.correction is Correction.PIT_SIZE:
            scale = effect.number("scale")
            pit = replace(pit, scale=scale, size_sd=effect.spread("scale") / scale)
    return pit


def effects_on(effects: Iterable[ConfirmedEffect], fruit_id: str) -> tuple[ConfirmedEffect, ...]:
    """The effects that apply to one fruit."""
    return tuple(effect for effect in effects if effect.fruits is None or fruit_id in effect.fruits)


def faults(effects: Iterable[ConfirmedEffect]) -> tuple[Fault, ...]:
    """The faults of the jaws for which drupe corrects every recording."""
    jaw_faults = []
    for effect in effects:
        if effect.spec.enters is Entry.RECORDING and effect.spec.correction is not None:
            names = [parameter.name for parameter in effect.spec.parameters]
            fields = {name.removeprefix("creep_"): effect.parameters[name] for name in names}
            jaw_faults.append(_FAULTS[effect.spec.correction](**fields))
    return tuple(jaw_faults)


_FAULTS: dict[Correction, Callable[..., Fault]] = {
    Correction.FORCE_GAIN: GainFault,
    Correction.FORCE_DRIFT: DriftFault,
    Correction.JAW_COMPLIANCE: ComplianceFault,
    Correction.CLOCK_LAG: LagFault,
    Correction.PAD_POSE: PoseFault,
    Correction.FORCE_LAW: ForceLawFault,
    Correction.GEL_CREEP: GelCreepFault,
    Correction.GEL_HYSTERESIS: GelHysteresisFault,
    Correction.THERMAL_DRIFT: ThermalFault,
}
"""The fault of a recording for each correction; its fields are the parameters of the effect."""


def in_words(effects: Iterable[ConfirmedEffect]) -> str:
    """Names of the effects for the ranking's `mismatch` column: sorted, joined by "+"."""
    return "+".join(sorted({effect.effect for effect in effects}))


def keyed(effects: Iterable[ConfirmedEffect]) -> list[dict[str, Any]]:
    """The entries for a fruit's key: effect, parameters and sd. The others do not change its result."""
    return [effect.model_dump(mode="json", include={"effect", "parameters", "sd"}) for effect in effects]

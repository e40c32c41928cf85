"""What an effect states of itself, beside its mechanics: all that other rooms derive from the catalogue.

Every effect of fem/mismatch/effects holds one EffectSpec. Settings and their limits, words in reports, advice
for the next grasp, corrections when grading: all are read from it.
"""

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

Family = Literal["object", "interaction", "measurement"]
Kind = Literal["number", "pair", "triple", "pad"]
KINDS: dict[int, Kind] = {0: "pad", 1: "number", 2: "pair", 3: "triple"}
"""By how many numbers are searched for."""


class Scope(StrEnum):
    """Whom an effect holds for once it is confirmed."""

    FRUIT = "one fruit"
    LOT = "the lot's flesh or skin"
    SENSOR = "a pad's sensor"
    GRIPPER = "the gripper"


class Entry(StrEnum):
    """Where grading takes a confirmed effect into account."""

    RECORDING = "recording"
    SETTINGS = "settings"
    MESH = "mesh"
    RESPONSE = "response"


class Correction(StrEnum):
    """What is put right before there is a model of a grasp, each by its own code in grading."""

    FORCE_GAIN = "force gain"
    FORCE_DRIFT = "force drift"
    JAW_COMPLIANCE = "jaw compliance"
    CLOCK_LAG = "clock lag"
    PAD_POSE = "pad pose"
    FORCE_LAW = "force law"
    GEL_CREEP = "gel creep"
    GEL_HYSTERESIS = "gel hysteresis"
    THERMAL_DRIFT = "thermal drift"
    POISSON_RATIO = "Poisson's ratio"
    PIT_OFFSET = "pit offset"
    PIT_SIZE = "pit size"


@dataclass(frozen=True, kw_only=True)
class ParameterSpec:
    """One number that the search varies, within the bounds `low` and `high`.

    A vector's components are parameters of their own, named "offset_mm.0" and so on; an answer joins them
    again.

    `low`, `high`: set by hand, wide: whatever a fruit or machine could have. The search is cut off there, and
    a second effect that ends at a bound is not accepted: it then stands for something else.

    `low_is_a_law`: the law at `low` is one that flesh may truly have, so that an end there is a result like
    any other. Example: `stiffening` at its least b is flesh that deforms largely and does not stiffen.

    `log`: it is searched for on a logarithmic scale.

    `spread`: its prior standard deviation in the refit; a quarter of the bounds' distance unless given.

    `model_sd` (in its unit), `model_share` (a share of its value): the error that the model's own inexactness
    leaves in the value however low the noise is; both are added in quadrature to its standard deviation.
    Measured, as the scatter about the truth over single effects by another solver
    (benchmarks/results/mismatch.csv). Example: 0.1 is a compliance of 0.20 mm/N that may be off by 0.02.

    `strain_power`: how the parameter follows E while the search varies E. The same forces strain flesh of
    half the E twice as much; the law acts on it as before where the parameter is changed by 2^strain_power.
    Example: `damage` sets in at W0/E, an energy that goes as the strain squared: its power is 2, and at half
    the E four times the W0/E does the same. 0: the law does not depend on how large strains are. Any other
    needs `log`.
    """

    name: str
    unit: str
    low: float
    high: float
    log: bool = False
    spread: float | None = None
    model_sd: float = 0.0
    model_share: float = 0.02
    strain_power: float = 0.0
    low_is_a_law: bool = False

    def __post_init__(self) -> None:
        if self.strain_power and not self.log:
            raise ValueError(f"{self.name}: a strain_power is for parameters on a logarithmic scale")


@dataclass(frozen=True, kw_only=True)
class EffectParameter:
    """One parameter as settings and answers carry it (docs/formats.md).

    `words`: its meaning. `limits`: what settings may hold, set by hand, wider than the search's bounds, as
    what was found may be far from usual. `searched`: what the search varies of it: one number, a vector's
    components in order, nothing for a pad. `modulus_power`: the parameter is the number searched for times
    E^modulus_power, E in MPa. `numbered`: settings may hold further ones of its kind ("g_2", "tau_2_s").
    """

    name: str
    unit: str
    words: str
    limits: tuple[float, float] = (0.0, 0.0)
    searched: tuple[ParameterSpec, ...] = ()
    modulus_power: float = 0.0
    numbered: bool = False

    @property
    def kind(self) -> Kind:
        """How many numbers it has; none where it is the name of a pad."""
        return KINDS[len(self.searched)]

    def is_named(self, name: str) -> bool:
        """Whether this is its name, or that of a further one of its kind.

        >>> tau = EffectParameter(name="tau_s", unit="s", words="", numbered=True)
        >>> [tau.is_named(name) for name in ("tau_s", "tau_2_s", "tau_s_2")]
        [True, True, False]
        """
        stem, _, rest = self.name.partition("_")
        further = rf"{re.escape(stem)}_\d+{re.escape(f'_{rest}' if rest else '')}"
        return name == self.name or (self.numbered and re.fullmatch(further, name) is not None)

    def searched_values(self, value: float | tuple[float, ...], *, E_MPa: float) -> dict[str, float]:
        """The numbers searched for, of flesh of modulus E."""
        values = value if isinstance(value, tuple) else (value,)
        scale = E_MPa**self.modulus_power
        return {
            spec.name: float(searched_value) / scale
            for spec, searched_value in zip(self.searched, values, strict=True)
        }


PAD = EffectParameter(name="pad", unit="", words="which pad")
"""The parameter of an effect that one pad has."""


def number(
    name: str,
    unit: str,
    words: str,
    *,
    limits: tuple[float, float],
    low: float,
    high: float,
    log: bool = False,
    model_share: float = 0.02,
    strain_power: float = 0.0,
    low_is_a_law: bool = False,
    model_sd: float = 0.0,
    numbered: bool = False,
) -> EffectParameter:
    """A parameter of which the search varies just the number that an answer gives."""
    searched = ParameterSpec(
        name=name,
        unit=unit,
        low=low,
        high=high,
        log=log,
        model_share=model_share,
        model_sd=model_sd,
        strain_power=strain_power,
        low_is_a_law=low_is_a_law,
    )
    return EffectParameter(
        name=name, unit=unit, words=words, limits=limits, searched=(searched,), numbered=numbered
    )


def vector(
    name: str,
    unit: str,
    words: str,
    *,
    components: int,
    limits: tuple[float, float],
    low: float,
    high: float,
    model_sd: float,
    spread: float | None = None,
) -> EffectParameter:
    """A parameter of several components, each searched for by itself as "name.0" and so on."""
    searched = tuple(
        ParameterSpec(
            name=f"{name}.{k}",
            unit=unit,
            low=low,
            high=high,
            spread=spread,
            model_sd=model_sd,
            model_share=0.0,
        )
        for k in range(components)
    )
    return EffectParameter(name=name, unit=unit, words=words, limits=limits, searched=searched)


@dataclass(frozen=True, kw_only=True)
class EffectWords:
    """An effect in words for staff: `short` completes "Most likely ...", the others are whole sentences."""

    short: str
    meaning: str
    advice: str


@dataclass(frozen=True, kw_only=True)
class EffectSpec:
    """One effect, but for its mechanics.

    `rank`: its place in the catalogue, a number of its own; it decides only between explanations that are
    exactly equal, for the lower. `family`: what of a grasp the physics belongs to: the fruit ("object"), the
    contact ("interaction"), or sensor and gripper ("measurement"); the bank's scores are given by it.
    `scope`: to whom a confirmed effect is applied: the one fruit (FRUIT), or every fruit of the batch, and
    whether it stays with the jaws when the fruit is turned (SENSOR, GRIPPER). Example: `pose_error` is of the
    family "interaction", being where pad and skin meet, and of the scope GRIPPER, since it stays with a jaw.

    `correction`: what grading puts right for it; None where it changes how flesh or contact answers a force.
    `of_the_pit`: there is none of it without a pit. `holds_large_deformation`: its law counts from
    small strain on, and holds the flesh's large deformation too. `in_recorded_forces`: the recorded forces
    already contain all that it does. The plain model, driven by those forces, then predicts the markers as
    well as with it: `respond` returns the plain model's displacement unchanged, E needs no correction, and
    nothing is written into `batch.toml`. Example: `adhesion`, whose pull at the skin the gel records as
    force. `knows_time`: its response depends on when the forces act or how fast the jaws go, not only on
    their course. `remembers_grasps`: what one recording has done to the flesh the next ones find so.
    """

    name: str
    rank: int
    family: Family
    scope: Scope
    words: EffectWords
    parameters: tuple[EffectParameter, ...]
    correction: Correction | None = None
    of_the_pit: bool = False
    holds_large_deformation: bool = False
    in_recorded_forces: bool = False
    knows_time: bool = False
    remembers_grasps: bool = False

    @property
    def searched(self) -> tuple[ParameterSpec, ...]:
        """What the search varies, in the order of the parameters."""
        return tuple(spec for parameter in self.parameters for spec in parameter.searched)

    def within_bounds(self, *values: float) -> dict[str, float]:
        """The searched parameters at these values, each cut off at its bounds."""
        return {
            spec.name: float(np.clip(value, spec.low, spec.high))
            for spec, value in zip(self.searched, values, strict=True)
        }

    @property
    def enters(self) -> Entry:
        """Where grading takes it into account."""
        if self.correction is None:
            return Entry.RESPONSE
        if self.of_the_jaws:
            return Entry.RECORDING
        return Entry.SETTINGS if self.correction is Correction.POISSON_RATIO else Entry.MESH

    @property
    def of_the_jaws(self) -> bool:
        """Whether it stays with a sensor or jaw when the fruit is turned."""
        return self.scope in (Scope.SENSOR, Scope.GRIPPER)

    def parameter(self, name: str) -> EffectParameter | None:
        """The parameter of that name, of a numbered one's too."""
        return next((parameter for parameter in self.parameters if parameter.is_named(name)), None)

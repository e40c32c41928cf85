"""Specification of an effect, apart from its mechanics: what other packages read from the catalogue.

Every effect of fem/mismatch/effects has one EffectSpec. It determines settings and their limits, words in
reports, advice for the next grasp, and corrections in grading.
"""

import re
from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum
from typing import Literal

import numpy as np

Family = Literal["object", "interaction", "measurement"]
Kind = Literal["number", "pair", "triple", "pad"]
KINDS: dict[int, Kind] = {0: "pad", 1: "number", 2: "pair", 3: "triple"}
"""Kind of a parameter by its count of numbers."""
LAW_ERROR = 0.15
"""Error of an effect's law, as a share of its signal. A second effect must exceed it where it resembles it.
In twelve labelled cases the signals that remain for other effects are 0.10 of the true effect's (root mean
square), and 0.5 at most."""
LAW_ERROR_OF_READINGS = 0.02
"""The same for a law of a sensor's readings, without mechanics. Set by hand, with the labelled cases in view
(`benchmarks/mismatch.py score`)."""


class Scope(StrEnum):
    """What a confirmed effect applies to."""

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
    """Corrections that grading makes before it builds a grasp model, each by its own code."""

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


@dataclass(frozen=True)
class EffectParameter:
    """One parameter, as settings and answers contain it (docs/formats.md) and as the search varies it.

    `words`: its meaning. `limits`: allowed range in settings. `low`, `high`: bounds of the search. A second
    effect that ends at a bound is rejected, since it then represents something else. All are set by hand,
    wide: they include any fruit or machine, and `limits` more than that. `components`: number of a vector's
    components; 0: the parameter is the name of a pad. `searched_as`: name of the searched number, if the
    parameter is that number times E^modulus_power, E in MPa. `numbered`: settings may contain further
    parameters of its kind ("g_2", "tau_2_s").

    `low_is_a_law`: flesh may truly have the law at `low`, so that a search that ends there is a valid result.
    Example: `stiffening` at its least b is flesh that deforms largely and does not stiffen.

    `log`: the search uses a logarithmic scale. `spread`: prior standard deviation in the refit; by default a
    quarter of the distance between the bounds.

    `strain_power`: how the parameter scales with E while the search varies E. Under the same forces, flesh of
    half the E has twice the strain. The law's effect stays the same if the parameter changes by
    2^strain_power. Example: `damage` begins at W0/E, an energy proportional to the strain squared. Its power
    is 2: half the E requires four times the W0/E. 0: the law does not depend on the size of strains. Any
    other power requires `log`.
    """

    name: str
    unit: str
    words: str
    _: KW_ONLY
    limits: tuple[float, float] = (0.0, 0.0)
    low: float = 0.0
    high: float = 0.0
    components: int = 1
    searched_as: str = ""
    modulus_power: float = 0.0
    numbered: bool = False
    low_is_a_law: bool = False
    log: bool = False
    spread: float | None = None
    strain_power: float = 0.0

    def __post_init__(self) -> None:
        if self.strain_power and not self.log:
            raise ValueError(f"{self.name}: a strain_power is for parameters on a logarithmic scale")

    @property
    def kind(self) -> Kind:
        """Kind by its count of numbers; a pad's name has none."""
        return KINDS[self.components]

    @property
    def searched(self) -> tuple["EffectParameter", ...]:
        """What the search varies: one number, nothing for a pad, or a vector's components. Each component is
        a parameter of its own, named "offset_mm.0" and so on.
        """
        name = self.searched_as or self.name
        names = [name] if self.components == 1 else [f"{name}.{k}" for k in range(self.components)]
        return tuple(replace(self, name=each, components=1, searched_as="") for each in names)

    def is_named(self, name: str) -> bool:
        """Whether this is its name, or the name of a further parameter of its kind.

        >>> tau = EffectParameter("tau_s", "s", "", numbered=True)
        >>> [tau.is_named(name) for name in ("tau_s", "tau_2_s", "tau_s_2")]
        [True, True, False]
        """
        stem, _, rest = self.name.partition("_")
        further = rf"{re.escape(stem)}_\d+{re.escape(f'_{rest}' if rest else '')}"
        return name == self.name or (self.numbered and re.fullmatch(further, name) is not None)

    def searched_values(self, value: float | tuple[float, ...], *, E_MPa: float) -> dict[str, float]:
        """The searched numbers, for flesh of modulus E."""
        values = value if isinstance(value, tuple) else (value,)
        scale = E_MPa**self.modulus_power
        return {
            spec.name: float(searched_value) / scale
            for spec, searched_value in zip(self.searched, values, strict=True)
        }


PAD = EffectParameter("pad", "", "which pad", components=0)
"""Parameter of an effect that belongs to one pad."""


@dataclass(frozen=True, kw_only=True)
class EffectWords:
    """An effect in words for staff: `short` completes "Most likely ...", the others are whole sentences."""

    short: str
    meaning: str
    advice: str


@dataclass(frozen=True, kw_only=True)
class EffectSpec:
    """One effect, without its mechanics.

    `rank`: its place in the catalogue, a unique number. Of explanations that are exactly equal, the lower
    rank wins. `family`: the part of a grasp that the physics belongs to: the fruit ("object"), the contact
    ("interaction"), or sensor and gripper ("measurement"); the bank's scores are grouped by it. `scope`: what
    a confirmed effect applies to: the one fruit (FRUIT) or every fruit of the batch. It also tells whether
    the effect stays with the jaws when the fruit is turned (SENSOR, GRIPPER). Example: `pose_error` has the
    family "interaction", as it is where pad and skin meet, and the scope GRIPPER, as it stays with a jaw.

    `correction`: what grading corrects for it; None if it changes the response of flesh or contact to a
    force. `of_the_pit`: it requires a pit. `holds_large_deformation`: its law starts at small strain and
    includes the flesh's large deformation. `in_recorded_forces`: the recorded forces already contain all of
    its consequences. The plain model, driven by those forces, then predicts the markers as well as with it:
    `respond` returns the plain model's displacement unchanged, E needs no correction, and nothing is written
    into `batch.toml`. Example: `adhesion`, whose pull at the skin the gel records as force. `knows_time`: its
    response depends on when the forces act or how fast the jaws go, not only on their path.
    `remembers_grasps`: its change of the flesh in one recording persists in the next ones. `of_readings`: its
    law changes the readings of a sensor, whatever the flesh does.
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
    of_readings: bool = False

    @property
    def searched(self) -> tuple[EffectParameter, ...]:
        """The searched numbers, in the order of the parameters."""
        return tuple(spec for parameter in self.parameters for spec in parameter.searched)

    def within_bounds(self, *values: float) -> dict[str, float]:
        """The searched parameters at these values, each clipped to its bounds."""
        return {
            spec.name: float(np.clip(value, spec.low, spec.high))
            for spec, value in zip(self.searched, values, strict=True)
        }

    @property
    def law_error(self) -> float:
        """Error of its law as a share of its signal."""
        return LAW_ERROR_OF_READINGS if self.of_readings else LAW_ERROR

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
        """The parameter of that name, or of a further one of its kind."""
        return next((parameter for parameter in self.parameters if parameter.is_named(name)), None)

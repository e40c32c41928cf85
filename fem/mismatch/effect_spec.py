"""What an effect states of itself, beside its mechanics: all that other rooms derive from the catalogue.

Every effect of fem/mismatch/effects holds one EffectSpec. Settings and their limits, words in reports, advice
for the next grasp, corrections when grading: all are read from it.
"""

import re
from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum
from typing import Literal

import numpy as np

Family = Literal["object", "interaction", "measurement"]
Kind = Literal["number", "pair", "triple", "pad"]
KINDS: dict[int, Kind] = {0: "pad", 1: "number", 2: "pair", 3: "triple"}
"""By how many numbers are searched for."""
LAW_ERROR = 0.15
"""Error of an effect's law in any direction, as a share of its signal. Error bars hold it, and a second
effect must exceed it. In twelve labelled cases the signals left for other effects are 0.10 of the true one's
(root mean square), and 0.5 at most."""
LAW_ERROR_OF_READINGS = 0.02
"""The same in error bars where the law is of a sensor's readings and holds no mechanics. Set by hand."""


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


@dataclass(frozen=True)
class EffectParameter:
    """One parameter as settings and answers carry it (docs/formats.md), and as the search varies it.

    `words`: its meaning. `limits`: what settings may hold. `low`, `high`: where the search is cut off; a
    second effect that ends there is not accepted, as it then stands for something else. All are set by hand,
    wide: whatever a fruit or machine could have, and of settings more than that. `components`: of a vector;
    0: the name of a pad. `searched_as`: name of the number searched for, where the parameter is that times
    E^modulus_power, E in MPa. `numbered`: settings may hold further ones of its kind ("g_2", "tau_2_s").

    `low_is_a_law`: the law at `low` is one that flesh may truly have, so that an end there is a result like
    any other. Example: `stiffening` at its least b is flesh that deforms largely and does not stiffen.

    `log`: it is searched for on a logarithmic scale. `spread`: its prior standard deviation in the refit; a
    quarter of the bounds' distance unless given.

    `strain_power`: how the parameter follows E while the search varies E. The same forces strain flesh of
    half the E twice as much; the law acts on it as before where the parameter is changed by 2^strain_power.
    Example: `damage` sets in at W0/E, an energy that goes as the strain squared: its power is 2, and at half
    the E four times the W0/E does the same. 0: the law does not depend on how large strains are. Any other
    needs `log`.
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
        """How many numbers it has; none where it is the name of a pad."""
        return KINDS[self.components]

    @property
    def searched(self) -> tuple["EffectParameter", ...]:
        """What the search varies of it: one number, nothing for a pad, or a vector's components, each a
        parameter of its own named "offset_mm.0" and so on.
        """
        name = self.searched_as or self.name
        names = [name] if self.components == 1 else [f"{name}.{k}" for k in range(self.components)]
        return tuple(replace(self, name=each, components=1, searched_as="") for each in names)

    def is_named(self, name: str) -> bool:
        """Whether this is its name, or that of a further one of its kind.

        >>> tau = EffectParameter("tau_s", "s", "", numbered=True)
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


PAD = EffectParameter("pad", "", "which pad", components=0)
"""The parameter of an effect that one pad has."""


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
    `of_readings`: its law changes what a sensor reads, whatever the flesh does.
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
        """What the search varies, in the order of the parameters."""
        return tuple(spec for parameter in self.parameters for spec in parameter.searched)

    def within_bounds(self, *values: float) -> dict[str, float]:
        """The searched parameters at these values, each cut off at its bounds."""
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
        """The parameter of that name, of a numbered one's too."""
        return next((parameter for parameter in self.parameters if parameter.is_named(name)), None)

"""One fruit's explanation as everything that is written of it has it: the JSON of the format drupe-mismatch
(docs/formats.md), the page and the terminal.

Made of the finder's own records by their attributes (`ExplainEntry.model_validate`), finished figures only.
Fields stand in the JSON's order and under its names; those of the page alone (`exclude=True`) come last.
Units are in the names; standard deviations are one sigma, intervals hold 90 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Annotated, Any, Final, Literal

import numpy as np
from jaxtyping import Float, Int
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_serializer,
    model_serializer,
)

FORMAT: Final = "drupe-mismatch"
VERSION: Final = 1
"""Name and number of the format that docs/formats.md describes; the number grows when an old reader would
fail."""


def _python(value: object) -> object:
    """Python's own number, or a list of them, of numpy's."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def _names(value: object) -> object:
    """A verdict of one name as one of several is."""
    return (value,) if isinstance(value, str) else value


Number = Annotated[int | float, BeforeValidator(_python)]
Point = tuple[Number, Number, Number]
Value = Annotated[int | float | tuple[Number, ...] | str, BeforeValidator(_python)]
Flag = Annotated[bool, BeforeValidator(_python)]


class _Entry(BaseModel):
    model_config = ConfigDict(
        frozen=True, from_attributes=True, populate_by_name=True, arbitrary_types_allowed=True
    )


class EffectEntry(_Entry):
    """An effect in words: `short` completes "Most likely ..."; `meaning` and `advice` are whole sentences."""

    short: str
    meaning: str
    advice: str


class WhereEntry(_Entry):
    """Where the mismatch sits: a region, and of a spot its centre and radius."""

    region: str
    centre_mm: Point | None = None
    radius_mm: Number | None = None


class ModulusEntry(_Entry):
    """E and its standard deviation, MPa."""

    value: Number
    sd: Number


class ModuliEntry(_Entry):
    """E without the effect and with it."""

    before: ModulusEntry
    after: ModulusEntry


class ParameterEntry(_Entry):
    """One parameter of an effect; `sd` None: not estimated; an interval of scalars, not written without."""

    value: Value
    sd: Annotated[int | float | tuple[Number, ...] | None, BeforeValidator(_python)]
    unit: str
    interval_90: tuple[Number, Number] | None = Field(default=None, validation_alias="interval")

    @model_serializer(mode="wrap")
    def _known(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written: dict[str, Any] = handler(self)
        if self.interval_90 is None:
            del written["interval_90"]
        return written


class CandidateEntry(_Entry):
    """One explanation: its probability among all tried, its evidence and what it does for held-out grasps."""

    effect: str
    probability: Number
    parameters: dict[str, ParameterEntry] = {}
    log_evidence: Number
    chi2_gain: Number = Field(validation_alias="gain")
    heldout_gain: Number | None = Field(default=None, validation_alias="heldout")
    refitted: Flag = False
    E_MPa: ModulusEntry | None = Field(default=None, validation_alias="modulus")


class FitEntry(_Entry):
    """Normalised force residual on grasps that the fit did not see; None where there are none."""

    heldout_rms_before: Number | None = Field(default=None, validation_alias="rms_before")
    heldout_rms_after: Number | None = Field(default=None, validation_alias="rms_after")
    noise_rms: Number | None = None


class VarianceEntry(_Entry):
    """How much of the modulus's variation one factor explains, and the probability of so much by chance."""

    factor: str
    share: Number
    p_value: Number


class CheckEntry(_Entry):
    """A number of the recordings, and what the model makes of it without and with the effect."""

    name: str
    measured: Number
    before: Number
    after: Number
    sd: Number
    unit: str


class CellEntry(_Entry):
    """The modulus that one frame of one pad gives by itself."""

    grasp: str
    pad: str
    time_s: Number
    phase: str
    E_MPa: Number
    E_sd_MPa: Number


class TraceEntry(_Entry):
    """One grasp by the fit of the others: force over how far the flesh gave way, measured and modelled."""

    grasp: str
    time_s: Float[np.ndarray, " t"]
    phase: tuple[str, ...]
    force_N: Float[np.ndarray, " t"]
    given_mm: Float[np.ndarray, " t"]
    before_mm: Float[np.ndarray, " t"]
    after_mm: Float[np.ndarray, " t"]


class MapEntry(_Entry):
    """Standard scores on the fruit's skin; `visible` below three is where nothing could be seen."""

    vertices_mm: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]
    modulus_score: Float[np.ndarray, " n"]
    eigenstrain_score: Float[np.ndarray, " n"]
    law_error: Float[np.ndarray, " n"]
    visible: Float[np.ndarray, " n"]


class ProposedPadEntry(_Entry):
    """Where one pad of a planned grasp goes: middle of its patch, direction of its push (fruit frame),
    angle round the stem from the first pad of the first recording. `patch_mm`, of the page alone: the skin
    that it touches.
    """

    pad: str
    centre_mm: Point
    direction: Point
    round_deg: Number
    patch_mm: Float[np.ndarray, "_p 3"] = Field(exclude=True)


class ProposedGraspEntry(_Entry):
    """One grasp that could be recorded next, and the ln evidence expected of it.

    `depth`, `speed`: over those of the recording `like`; `hold_s` None: as there. `gain`:
    between the two explanations of `pair`; `decides`: probability that it sets the true one apart.
    """

    place: str
    like: str
    pads: tuple[ProposedPadEntry, ...]
    depth: Number
    speed: Number
    hold_s: Number | None
    cycles: int
    turned: Flag
    gain: Number
    pair: tuple[str, str]
    decides: Number


class NextGraspPlanEntry(_Entry):
    """The most telling grasps to record next, best first, of so many tried."""

    grasps: tuple[ProposedGraspEntry, ...]
    tried: int


class ExplainEntry(_Entry):
    """All that is written of one fruit. `verdict`: the names left; one, or several not told apart.

    `E_withheld`: why no E is given, which is then not a number. `doubts`: why E cannot be right. `applied`:
    one sentence where the effect was written into a batch's settings, or why it was not. `inputs`: SHA-256 in
    hex by file. Of the page alone:
    `effects`, words of the single effects in verdict and ranking; `parameter_words`, meanings by effect and
    parameter; `contacts_mm`, where each pad touched, all grasps
    together; `facts`, (label, value): Poisson's ratio, elements.
    """

    format: Literal["drupe-mismatch"] = FORMAT
    version: Literal[1] = VERSION
    detected: Flag
    p_value: Number
    where: WhereEntry
    when: str
    component: str
    ranking: tuple[CandidateEntry, ...]
    verdict: Annotated[tuple[str, ...], BeforeValidator(_names)]
    E_MPa: ModuliEntry
    E_withheld: str | None = Field(default=None, validation_alias="withheld")
    doubts: tuple[str, ...] = ()
    fit: FitEntry = FitEntry()
    next_grasp: str | None = None
    next_grasp_plan: NextGraspPlanEntry | None = None
    statistics: Mapping[str, Number] = {}
    variance: tuple[VarianceEntry, ...] = ()
    checks: tuple[CheckEntry, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: Mapping[str, Number] = {}
    case: str
    category: str
    grasps: tuple[str, ...] = ()
    applied: str | None = None
    inputs: Mapping[str, str] = {}
    versions: Mapping[str, str] = {}
    made_utc: datetime
    cells: tuple[CellEntry, ...] = Field(default=(), exclude=True)
    traces: tuple[TraceEntry, ...] = Field(default=(), exclude=True)
    maps: MapEntry | None = Field(default=None, exclude=True)
    effects: Mapping[str, EffectEntry] = Field(default={}, exclude=True)
    parameter_words: Mapping[str, Mapping[str, str]] = Field(default={}, exclude=True)
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] = Field(default={}, exclude=True)
    facts: tuple[tuple[str, str], ...] = Field(default=(), exclude=True)

    @property
    def rms(self) -> tuple[float, float, float] | None:
        """The fit's residual before, after, and of noise alone; None where no grasp was held out."""
        fit = self.fit
        if fit.heldout_rms_before is None or fit.heldout_rms_after is None or fit.noise_rms is None:
            return None
        return fit.heldout_rms_before, fit.heldout_rms_after, fit.noise_rms

    @field_serializer("verdict")
    def _one_or_several(self, verdict: tuple[str, ...]) -> str | tuple[str, ...]:
        return verdict[0] if len(verdict) == 1 else verdict

    @field_serializer("made_utc")
    def _to_the_second(self, made: datetime) -> str:
        return made.isoformat(timespec="seconds")

    def as_json(self) -> dict[str, Any]:
        """What the format drupe-mismatch holds, as plain JSON values: a number that is not finite is null. A
        plan that was not computed, the reason of an E that is given, and doubts where there are none are left
        out.
        """
        optional = {"next_grasp_plan", "E_withheld", "doubts"}
        written: dict[str, Any] = _finite(self.model_dump())
        return {name: known for name, known in written.items() if known or name not in optional}


def _finite(value: Any) -> Any:
    """The same values, a number that is not finite as None."""
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""`record.json` of one fruit: everything known about it, with a schema version."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fem.mismatch.result import NONE, UNKNOWN, Modulus
from pipeline.batch.fruits_table import Given
from pipeline.batch.layout import write_whole
from pipeline.files.plain_file import not_plain
from reports.grasp_record import GraspRecord


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True)


R = TypeVar("R", bound=BaseModel)


class OrientationRecord(_Record):
    """Stem and suture according to the shape, in the fruit frame. `tilt_deg`: of the stem axis from z.
    `turn_deg`: of the groove from +x towards +y. Depths are of hollow and groove, confidences from 0 to 1.
    """

    tilt_deg: float
    stem_confidence: float
    hollow_mm: float
    turn_deg: float
    suture_confidence: float
    groove_mm: float


class MeshRecord(_Record):
    """The fruit's surface: its source, size and quality."""

    source: Literal["photos", "fruit.ply"]
    vertices: int
    faces: int
    volume_mm3: float
    height_mm: float
    box_mm: tuple[float, float, float]
    scale_sd: float | None = None
    surface_sd_mm: float | None = None
    quality: dict[str, int | float] = {}
    """Quality of a mesh from photos, by the names of recon.checks.quality.ReconQuality."""
    stance: OrientationRecord | None = None


class PitRecord(_Record):
    """The embedded pit: from a category prior, or the user's own."""

    source: str
    volume_mm3: float
    centre_mm: tuple[float, float, float]
    box_mm: tuple[float, float, float]
    thinnest_flesh_mm: float
    flesh_volume_mm3: float
    size_sd: float | None = None
    """Relative standard deviation of its size, as grading used it; None before grading."""


class PressedRecord(_Record):
    """A fruit without mesh: its diameters (mm) and the axis of its recordings (`compressed_along`).
    `pit_share`: the pit's diameter over the fruit's, from `pit_source`.

    `shape_sd`: standard deviation of ln E because three diameters do not fix the shape.
    """

    diameters_mm: tuple[float, float, float]
    compressed_along: tuple[Literal["a", "b", "c"], ...]
    pit_share: float
    pit_source: str
    shape_sd: float


class FleshRecord(_Record):
    """The mechanical model: finite-element mesh of the flesh and its assumed Poisson's ratio."""

    nodes: int
    tets: int
    poisson_ratio: float
    poisson_ratio_sd: float
    poisson_ratio_source: str
    solver: str = ""


class PitFoundRecord(_Record):
    """The pit's place and size from two or more grasps, against the prior's, with one sd each; fruit frame.

    `moved`: by how many of the prior's standard deviations the data moved x, y, z and size.
    """

    offset_mm: tuple[float, float, float]
    offset_sd_mm: tuple[float, float, float]
    offset_prior_sd_mm: tuple[float, float, float]
    size: float
    size_sd: float
    size_prior_sd: float
    moved: tuple[float, float, float, float]


class ModulusRecord(_Record):
    """The flesh's modulus from all grasps together, and the error bar's parts (MPa, one sd each)."""

    E_MPa: float
    E_sd_MPa: float
    common_sd_MPa: float = 0.0
    """The part of E_sd_MPa that all fruit of the batch share, so that it does not affect their order."""
    scale_sd_MPa: float = 0.0
    """Not in E_sd_MPa: error by a common factor on force and gel stiffness, which no recording shows."""
    parts_sd_MPa: dict[str, float] = {}
    pit_found: PitFoundRecord | None = None

    def scaled(self, factor: float) -> Self:
        """E, its error and all parts of the error, times a factor."""
        names = ("E_MPa", "E_sd_MPa", "common_sd_MPa", "scale_sd_MPa")
        numbers = {name: factor * getattr(self, name) for name in names}
        parts = {name: factor * sd for name, sd in self.parts_sd_MPa.items()}
        return self.model_copy(update={**numbers, "parts_sd_MPa": parts})

    def widened(self, part: str, sd_MPa: float, *, shared: bool) -> Self:
        """The same E with `sd_MPa` added in quadrature to its error and to the `part` of that. `shared`: all
        fruit of the batch share this error, so that it does not affect their order.
        """
        parts = self.parts_sd_MPa
        return self.model_copy(
            update={
                "E_sd_MPa": math.hypot(self.E_sd_MPa, sd_MPa),
                "common_sd_MPa": math.hypot(self.common_sd_MPa, sd_MPa if shared else 0.0),
                "parts_sd_MPa": parts | {part: math.hypot(parts.get(part, 0.0), sd_MPa)},
            }
        )


class ReferenceRecord(_Record):
    """E against the batch's reference bodies. `ratio`: of their measured modulus over the known one, with its
    standard deviation. `E_MPa`: as in the ranking, divided by the ratio if `corrected`.
    """

    bodies: tuple[str, ...]
    ratio: float
    ratio_sd: float
    corrected: bool
    E_MPa: float
    E_sd_MPa: float
    E_scale_sd_MPa: float = 0.0


class TemperatureRecord(_Record):
    """E at the reference temperature, `factor` times E at the temperature at which the fruit was grasped."""

    pulp_C: float
    reference_C: float
    factor: float
    E_at_pulp_MPa: float
    E_at_pulp_sd_MPa: float
    E_MPa: float
    E_sd_MPa: float


class AmountRecord(_Record):
    """One parameter of an effect of the sensor or the jaws, fitted together with the fruit's own effects. Its
    unit is that of the effect's linear signature. `pad` is empty for the whole gripper.
    """

    effect: str
    pad: str = ""
    parameter: str
    value: float
    sd: float


class SuspectedRecord(_Record):
    """The change of E by a suspected effect: E with it over E without it, and the relative standard deviation
    that it adds to E. `effect`: one name, two joined by "+", or several that the data cannot distinguish,
    joined by "|".
    """

    effect: str
    E_ratio: float
    added_sd: float = 0.0


class _NamedEffect(BaseModel):
    effect: str


class _Modulus(BaseModel):
    value: float | None = None
    sd: float | None = None


class _Moduli(BaseModel):
    before: _Modulus = _Modulus()
    after: _Modulus = _Modulus()


class DiagnosisRecord(BaseModel):
    """Key and result in a fruit's mismatch.json (drupe explain), as far as grading reads them."""

    key: str
    verdict: str | tuple[str, ...]
    ranking: tuple[_NamedEffect, ...]
    p_value: float | None = None
    p_nominal: str | None = None
    E_MPa: _Moduli = _Moduli()

    @property
    def names(self) -> tuple[str, ...]:
        """The verdict's names, the most likely first."""
        names = (self.verdict,) if isinstance(self.verdict, str) else self.verdict
        order = {hypothesis.effect: place for place, hypothesis in enumerate(self.ranking)}
        return tuple(sorted(names, key=lambda name: order.get(name, len(order))))

    @property
    def suspected(self) -> tuple[SuspectedRecord, ...]:
        """E with the verdict's effects; empty if the most likely name is no known effect, or E is missing."""
        if self.names[0] in (NONE, UNKNOWN):
            return ()
        effects = [name for name in self.names if name not in (NONE, UNKNOWN)]
        return suspected_of("|".join(effects), self.E_MPa.before, self.E_MPa.after)


def suspected_of(
    effect: str, before: Modulus | _Modulus, after: Modulus | _Modulus
) -> tuple[SuspectedRecord, ...]:
    """E with an effect over E without it; empty if either is not a positive number."""
    known = [
        estimate.value
        for estimate in (before, after)
        if estimate.value is not None and 0 < estimate.value < math.inf
    ]
    if len(known) < 2:
        return ()
    shares = [(estimate.sd or 0.0) / value for estimate, value in zip((before, after), known, strict=True)]
    added = math.sqrt(max(shares[1] ** 2 - shares[0] ** 2, 0.0))
    return (SuspectedRecord(effect=effect, E_ratio=known[1] / known[0], added_sd=added),)


class ScreenRecord(_Record):
    """Result of the screen for missing physics: p, and the suggested names (empty: none), the most likely
    first. `failure`: why there is no result. `p_nominal`: p is not calibrated (force-displacement curves).

    `gains`: log Bayes factor of each effect's best signature over none. `amounts`: faults that all fruit of a
    batch share. `suspected`: E with each suggested name that is a known effect. `note`: omissions.
    """

    p_value: float | None = None
    p_nominal: bool = False
    names: tuple[str, ...] = ()
    statistics: dict[str, float] = {}
    gains: dict[str, float] = {}
    amounts: tuple[AmountRecord, ...] = ()
    suspected: tuple[SuspectedRecord, ...] = ()
    note: str = ""
    failure: str = ""
    again: bool = False
    """Whether another attempt may succeed after a failure."""


class FruitRecord(_Record):
    """Everything known of one fruit."""

    format: Literal["drupe-fruit-record"] = "drupe-fruit-record"
    version: Literal[1] = 1
    fruit_id: str
    outcome: str
    reason: str = ""
    key: str
    given: Given
    mesh: MeshRecord | None = None
    pit: PitRecord | None = None
    pressed: PressedRecord | None = None
    flesh: FleshRecord | None = None
    grasps: tuple[GraspRecord, ...] = ()
    modulus: ModulusRecord | None = None
    reference: ReferenceRecord | None = None
    """Set once the whole batch is graded; `modulus` and `grasps` of record.json stay as measured."""
    temperature: TemperatureRecord | None = None
    """Set like `reference`, and after it."""
    mismatch: str | None = None
    """Effects of the settings' [[mismatch]] that the modulus takes into account, joined by "+"."""
    screen: ScreenRecord | None = None
    """Result of the screen for missing physics; None if it did not run."""
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    """Those warnings that name contradictions in the inputs. They widen E's error bar, except those in
    `forced`."""
    forced: tuple[str, ...] = ()
    """Those doubts on numbers outside the category's plausible range, which `--force` accepted."""
    copied: tuple[str, ...] = ()
    """Those doubts on recordings that other fruit of the batch have too. Set once the whole batch is graded;
    `modulus` stays as measured."""
    strangers: dict[str, bool] = {}
    """Other fruit that recordings of this one name, and whether the batch had them then. Use and doubts of
    the recordings depend on it."""
    seconds: dict[str, float] = {}
    peak_memory_MiB: float | None = None

    @property
    def graded(self) -> bool:
        """Whether the outcome is "graded", with a modulus."""
        return self.outcome == "graded" and self.modulus is not None

    @property
    def ranked_modulus(self) -> tuple[float | None, float | None]:
        """E and its sd in MPa, by priority: `temperature`, `reference`, `modulus`; None if not graded."""
        against_bodies = None if self.given.reference else self.reference
        ranked = self.temperature or against_bodies or self.modulus
        return (ranked.E_MPa, ranked.E_sd_MPa) if self.graded and ranked is not None else (None, None)

    def with_doubts(self, field: Literal["forced", "copied"], said: Sequence[str]) -> Self:
        """The record with these doubts in `field` in place of an earlier run's; its modulus stays."""
        before = getattr(self, field)
        doubts, warnings = (
            (*said, *(sentence for sentence in sentences if sentence not in before))
            for sentences in (self.doubts, self.warnings)
        )
        changed = {field: tuple(said), "doubts": doubts, "warnings": warnings}
        return self if tuple(said) == before else self.model_copy(update=changed)


def write_record(path: Path, record: FruitRecord) -> None:
    """Writes the record as JSON, whole or not at all. Raises NotWritten."""
    write_whole(path, record.model_dump_json(indent=1) + "\n")


def write_changed(path: Path, before: FruitRecord, now: FruitRecord) -> FruitRecord:
    """Writes the record `now` if it differs from `before`, and returns it."""
    if now != before:
        write_record(path, now)
    return now


def read_record(path: Path) -> FruitRecord | None:
    """The record at `path`; None if this version cannot read one there."""
    return read_as(path, FruitRecord)


def read_as(path: Path, record: type[R]) -> R | None:
    """The JSON file at `path` as such a record; None if it is missing, unreadable or invalid."""
    if not_plain(path):
        return None
    try:
        return record.model_validate_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValidationError):
        return None

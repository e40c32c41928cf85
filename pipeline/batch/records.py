"""What one fruit's `record.json` holds: everything known of the fruit, schema versioned."""

import math
from pathlib import Path
from typing import Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from pipeline.batch.fruits_table import Given
from pipeline.batch.layout import write_whole
from pipeline.files.plain_file import not_plain
from reports.grasp_record import GraspRecord


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True)


R = TypeVar("R", bound=BaseModel)


class OrientationRecord(_Record):
    """What the shape says of stem and suture, against the fruit frame: `tilt_deg` of the stem axis from z,
    `turn_deg` of the groove from +x towards +y, depths of hollow and groove, confidences from 0 to 1.
    """

    tilt_deg: float
    stem_confidence: float
    hollow_mm: float
    turn_deg: float
    suture_confidence: float
    groove_mm: float


class MeshRecord(_Record):
    """The fruit's surface: where it came from, its size, and how good it is."""

    source: Literal["photos", "fruit.ply"]
    vertices: int
    faces: int
    volume_mm3: float
    height_mm: float
    box_mm: tuple[float, float, float]
    scale_sd: float | None = None
    surface_sd_mm: float | None = None
    quality: dict[str, int | float] = {}
    """What is known of a mesh of photos, by the names of recon.checks.quality.ReconQuality."""
    stance: OrientationRecord | None = None


class PitRecord(_Record):
    """The pit that was embedded: from a category prior, or the user's own."""

    source: str
    volume_mm3: float
    centre_mm: tuple[float, float, float]
    box_mm: tuple[float, float, float]
    thinnest_flesh_mm: float
    flesh_volume_mm3: float
    size_sd: float | None = None
    """Relative standard deviation of its size that graded the fruit; None before it is graded."""


class PressedRecord(_Record):
    """A fruit of which there is no mesh, only its diameters (mm) and plates that squeezed it along the first
    of `compressed_along`; `pit_share`: the pit's diameter over the fruit's, said by `pit_source`.

    `shape_sd`: standard deviation of ln E because three diameters are not the shape.
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
    """Where two or more grasps put the pit, against the prior's, fruit frame; one standard deviation each.

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
    """The part of E_sd_MPa that all fruit of the batch share, so that it does not touch their order."""
    scale_sd_MPa: float = 0.0
    """Beside E_sd_MPa, by a common factor on force and gel stiffness, which no recording shows."""
    parts_sd_MPa: dict[str, float] = {}
    pit_found: PitFoundRecord | None = None

    def scaled(self, factor: float) -> Self:
        """E, its error and all parts of that times a factor."""
        names = ("E_MPa", "E_sd_MPa", "common_sd_MPa", "scale_sd_MPa")
        numbers = {name: factor * getattr(self, name) for name in names}
        parts = {name: factor * sd for name, sd in self.parts_sd_MPa.items()}
        return self.model_copy(update={**numbers, "parts_sd_MPa": parts})

    def widened(self, part: str, sd_MPa: float, *, shared: bool) -> Self:
        """The same E, a part of whose error is wider by a standard deviation; `shared`: by one that all fruit
        of the batch have in common, so that it does not touch their order.
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
    """What the batch's reference bodies say of this fruit's E: the ratio r of the modulus found of them over
    the known one, with its standard deviation, and E as the ranking has it, `corrected` (divided by r) or
    not.
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
    """One number of an effect that stays with a sensor or with the jaws, beside all that the fruit may have,
    in the unit of the effect's linear signature; `pad` is empty for the whole gripper.
    """

    effect: str
    pad: str = ""
    parameter: str
    value: float
    sd: float


class SuspectedRecord(_Record):
    """What an effect that is suspected would do to E: E with it over E without, and the relative standard
    deviation that it adds to E. `effect`: one name, two joined by "+", or several that cannot be told apart
    with "|" between.
    """

    effect: str
    E_ratio: float
    added_sd: float = 0.0


class ScreenRecord(_Record):
    """What the screen for missing physics says: p, names that it suggests (none: nothing was found) with the
    likeliest first, or in `failure` why it says nothing. `p_nominal`: p is not calibrated (of curves).

    `gains`: ln evidence of the best signature of each effect over that of none. `amounts`: for faults that
    all fruit of a batch have in common. `suspected`: E with each of the names that is a known effect. `note`:
    what was left out.
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
    """Whether what failed may come out otherwise when it is tried again."""


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
    """The same, after `reference`."""
    mismatch: str | None = None
    """Effects of the settings' [[mismatch]] that the modulus takes into account, joined by "+"."""
    screen: ScreenRecord | None = None
    """What the screen for missing physics says; None where it was left out."""
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    """Of the warnings, those that name what cannot be right in the inputs; E's error bar is the wider, but
    not by what is `forced`."""
    forced: tuple[str, ...] = ()
    """Of the doubts, those on numbers that no fruit has, in spite of which `--force` graded it."""
    copied: tuple[str, ...] = ()
    """Of the doubts, those on recordings that other fruit of the batch have too; set once the whole batch is
    graded, `modulus` stays as measured."""
    strangers: dict[str, bool] = {}
    """Other fruit that recordings of this one name, and whether the batch had them then: what is used, and
    what is doubted, depends on it."""
    seconds: dict[str, float] = {}
    peak_memory_MiB: float | None = None

    @property
    def graded(self) -> bool:
        """Whether the fruit went all the way."""
        return self.outcome == "graded" and self.modulus is not None

    @property
    def ranked_modulus(self) -> tuple[float | None, float | None]:
        """E and its standard deviation in MPa as the ranking has them; None of a fruit that is not graded."""
        against_bodies = None if self.given.reference else self.reference
        ranked = self.temperature or against_bodies or self.modulus
        return (ranked.E_MPa, ranked.E_sd_MPa) if self.graded and ranked is not None else (None, None)


def write_record(path: Path, record: FruitRecord) -> None:
    """Writes the record as JSON, whole or not at all."""
    write_whole(path, record.model_dump_json(indent=1) + "\n")


def read_record(path: Path) -> FruitRecord | None:
    """The record at `path`; None where there is none that this version can read."""
    return read_as(path, FruitRecord)


def read_as(path: Path, record: type[R]) -> R | None:
    """What the JSON file at `path` holds, as such a record; None where there is none that can be read."""
    if not_plain(path):
        return None
    try:
        return record.model_validate_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValidationError):
        return None

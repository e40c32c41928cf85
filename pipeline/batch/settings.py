"""`batch.toml`: the settings of a batch, read strictly (unknown keys are refused)."""

import datetime
import itertools
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from fem.elements.assembly import LARGEST_POISSON_RATIO
from pipeline.batch.confirmed_effects import ConfirmedEffect
from pipeline.batch.fruits_table import COLUMNS, USER_COLUMN, canonical
from pipeline.files.plain_file import composed, printable
from pipeline.safe_start import elsewhere
from recon.cameras.coin import Coin, coin_named
from recon.pit.priors import LEAST_POISSON_RATIO
from recon.recon_failure import ReconFailure

Name = Annotated[str, Field(min_length=1, max_length=200)]
"""At most 200 characters. Set by hand: longer text was pasted into the wrong place."""
Label = Annotated[Name, AfterValidator(composed)]
"""A name that people compare, which names no file."""
Words = Annotated[str, Field(max_length=10_000), AfterValidator(composed)]
"""Free text, at most 10,000 characters (four pages). Set by hand: more was pasted into the wrong place."""
Relative = Annotated[float, Field(ge=1e-4, le=0.5)]
"""A relative standard deviation. 0.5 leaves the quantity practically unknown. No gel or pit reaches 1e-4,
below a force standard's error (ISO 376, class 00: 5e-4)."""
Shift = Annotated[float, Field(ge=1e-3, le=20)]
"""A standard deviation in mm: at 20 mm a pit is outside its fruit, and no gripper places a pad to 1 µm."""
Stiffness = Annotated[float, Field(ge=1e-6, le=1e4)]
"""Stiffness of a gel per area of its face, MPa/mm; limits as of recordings (tactile.readers.recording)."""
Day = Annotated[datetime.date, Field(ge=datetime.date(1990, 1, 1), le=datetime.date(2100, 1, 1))]
"""Day of a harvest, of grasps or of a calibration. Set by hand: another year is a typing error."""
HISTORY_COLUMNS = (
    "batch", "calibrated_on", "calibration", "doubted", "graded_utc", "gripper_serial", "revision",
    "sensor_serial", "temperature_C",
)  # fmt: skip
"""Columns of the tables of `drupe history` that are neither settings nor columns of other tables."""


class Strict(BaseModel):
    """A table of settings that refuses unknown keys, numbers that are not finite, and true for a number."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _printable(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, bool) and "bool" not in str(cls.model_fields[str(info.field_name)].annotation):
            raise ValueError("expected no true or false here")
        return printable(value).strip() if isinstance(value, str) else value


class GradingClass(Strict):
    """A maturity class: every fruit with E up to `E_max_MPa` that belongs to no softer class.

    `ship`: whether its fruit are shipped now; None: the class's default (`Grading.shipped`).
    """

    name: Annotated[str, Field(min_length=1, max_length=80), AfterValidator(composed)]
    E_max_MPa: Annotated[float, Field(ge=1e-6, le=1e9)] | None = None
    ship: bool | None = None


class Grading(Strict):
    """Maturity classes of the batch, softest first; the last class has no upper limit.

    `certainty`: the probability from which a class, and the decision to ship or hold, counts as certain.
    `inspect_below_p`: drupe lists a fruit for inspection if its screen has a smaller p.
    """

    classes: Annotated[tuple[GradingClass, ...], Field(max_length=50)] = ()
    certainty: Annotated[float, Field(ge=0.5, le=0.9999)] = 0.9
    """Set by hand: at this probability, one fruit in ten belongs to another class. Below 0.5, a fruit could
    be certain of two lists."""
    inspect_below_p: Annotated[float, Field(ge=0, le=1)] = 0.001
    """Set by hand: one in a thousand fruit without mismatch. The screen names effects below 0.05."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        """Raises ValueError unless names differ, the classes' limits grow and only the last has none."""
        for softer, firmer in itertools.pairwise(self.classes):
            if softer.E_max_MPa is None:
                raise ValueError(
                    f'E_max_MPa of class "{softer.name}" is missing; '
                    "only the last (firmest) class may omit it"
                )
            if firmer.E_max_MPa is not None and firmer.E_max_MPa <= softer.E_max_MPa:
                slip = ": is one of them in kPa?" if softer.E_max_MPa > 100 * firmer.E_max_MPa else ""
                raise ValueError(
                    f"E_max_MPa must grow from class to class; found {firmer.E_max_MPa:g} for "
                    f'"{firmer.name}" after {softer.E_max_MPa:g} for "{softer.name}"{slip}'
                )
        if self.classes and self.classes[-1].E_max_MPa is not None:
            raise ValueError(
                "the last (firmest) class must have no E_max_MPa, so that every fruit gets a class"
            )
        names = [c.name for c in self.classes]
        if len(set(names)) != len(names):
            raise ValueError(f"class names must differ, found {names}")
        return self

    @property
    def shipped(self) -> tuple[bool, ...] | None:
        """For each class, whether its fruit are shipped: its `ship`, by default all but the firmest. None
        without classes, or for a single one without `ship`: then nothing separates the fruit.
        """
        if len(self.classes) < 2 and all(c.ship is None for c in self.classes):
            return None
        default = (*(True for _ in self.classes[1:]), False)
        return tuple(
            goes if c.ship is None else c.ship for c, goes in zip(self.classes, default, strict=True)
        )


NO_PIT = "none"
"""The pit prior of fruit without a pit."""


class PitSettings(Strict):
    """The pit prior, and the standard deviations of the true pit's place (mm) and size (relative) from it.

    With prior "none", a fruit without a pit.ply has no pit.
    """

    prior: Name | None = None
    offset_sd_mm: Shift | None = None
    size_sd: Relative | None = None

    @property
    def none(self) -> bool:
        """Whether fruit without a pit.ply have no pit."""
        return self.prior == NO_PIT


class Recon(Strict):
    """Settings for photos. `geometry_model`: a local ONNX file, relative to the batch, which runs on the
    first available of the ONNX Runtime `providers`. `fruit_model`: whether the shipped model finds the pixels
    of the fruit.
    """

    geometry_model: Name | None = None
    fruit_model: bool = True
    providers: Annotated[tuple[Name, ...], Field(max_length=20)] = ("CPUExecutionProvider",)
    max_faces: Annotated[int, Field(ge=1000, le=100_000)] = 8000


class Photos(Strict):
    """A coin beside the fruit, for scale without a mat: its name (recon/coins.toml) or its diameter in mm."""

    coin: Name | None = None
    coin_mm: Annotated[float, Field(ge=10, le=50)] | None = None

    @field_validator("coin")
    @classmethod
    def _known(cls, coin: str | None) -> str | None:
        if coin is not None:
            try:
                coin_named(coin)
            except ReconFailure as failure:
                raise ValueError(failure.detail) from None
        return coin

    @model_validator(mode="after")
    def _one(self) -> Self:
        if self.coin is not None and self.coin_mm is not None:
            raise ValueError("give coin or coin_mm, not both")
        return self

    @property
    def scale(self) -> Coin | None:
        """The coin, if there is one."""
        if self.coin is not None:
            return coin_named(self.coin)
        return None if self.coin_mm is None else Coin(name="coin_mm", diameter_mm=self.coin_mm)


class MeshSettings(Strict):
    """Longest element edges in mm: in the bulk of the flesh, and under the pads.

    `pad_edge_mm`: by default a fifth of each contact's width and at most 1.7 mm (fem.mesh.flesh_mesh).
    """

    edge_mm: Annotated[float, Field(ge=1, le=20)] = 5.0
    pad_edge_mm: Annotated[float, Field(ge=0.3, le=10)] | None = None


class FleshSettings(Strict):
    """How the flesh deforms: "neo-hookean" (large deformation) or "linear" (small strain, quicker)."""

    model: Literal["neo-hookean", "linear"] = "neo-hookean"


class Device(Strict):
    """Name and serial number of a device, stored with the results."""

    name: Annotated[str, Field(max_length=200), AfterValidator(composed)]
    serial: Label | None = None


class SensorSettings(Device):
    """The tactile sensor, with errors that its maker or calibration states: relative scale errors of single
    markers, and the standard deviation of a pad's place along the skin (mm).

    `common_scale_sd`: of a common factor on force and gel stiffness, if a recording states none.
    `picture_scale_sd`: of the scale of the gel's pictures. `gel_kn_MPa_per_mm` and `gel_kt_MPa_per_mm`: the
    gel's known stiffness, with the relative error `gel_stiffness_sd`; drupe compares each recording's with
    it.
    """

    gel_scale_sd: Relative | None = None
    force_scale_sd: Relative | None = None
    pose_sd_mm: Shift | None = None
    common_scale_sd: Relative | None = None
    picture_scale_sd: Relative | None = None
    gel_kn_MPa_per_mm: Stiffness | None = None
    gel_kt_MPa_per_mm: Stiffness | None = None
    gel_stiffness_sd: Relative = 0.05
    calibration: Label | None = None
    calibrated_on: Day | None = None
    """Name and day of the calibration."""

    @property
    def calibrated(self) -> bool:
        """Whether a calibration is named or dated."""
        return self.calibration is not None or self.calibrated_on is not None

    @property
    def gel_stiffness(self) -> dict[str, tuple[float, float]]:
        """The known stiffness and its relative standard deviation, by name; empty if none is stated."""
        known = {
            "gel_kn_MPa_per_mm": self.gel_kn_MPa_per_mm,
            "gel_kt_MPa_per_mm": self.gel_kt_MPa_per_mm,
        }
        return {name: (value, self.gel_stiffness_sd) for name, value in known.items() if value is not None}


class TemperatureSettings(Strict):
    """The user's change of E with temperature, relative per degree C (d ln E / dT), with its standard
    deviation. `reference_C`: the temperature at which drupe reports E.
    """

    reference_C: Annotated[float, Field(ge=-5, le=50)]
    E_per_C: Annotated[float, Field(ge=-0.2, le=0.2)]
    E_per_C_sd: Annotated[float, Field(ge=0, le=0.2)]


class ReferenceSettings(Strict):
    """Use of reference bodies (fruits.csv) whose measured modulus differs from the known one. `correct`:
    drupe divides every fruit's E by the ratio; otherwise every E is in doubt.
    """

    correct: bool = False


class Settings(Strict):
    """The settings of a batch in `batch.toml`; only the category is required.

    `rig`: the file of the jaws' machine compliance, relative to the batch (pipeline.batch.rig_setting).
    """

    category: Name
    cultivar: Words | None = None
    lot: Annotated[str, Field(max_length=200), AfterValidator(composed)] | None = None
    """At most as many characters as its QR code holds; empty means none."""
    orchard: Words | None = None
    operator: Words | None = None
    packer: Words | None = None
    """Who packed the lot, for the printed sheets."""
    harvest_date: Day | None = None
    measured_on: Day | None = None
    """The day of the grasps, for `drupe history`; by default that of the first grading."""
    pulp_temperature_C: Annotated[float, Field(ge=-5, le=50)] | None = None
    temperature: TemperatureSettings | None = None
    poisson_ratio_sd: Annotated[float, Field(ge=0, le=0.2)] | None = None
    poisson_ratio: Annotated[float, Field(ge=LEAST_POISSON_RATIO, le=LARGEST_POISSON_RATIO)] | None = None
    notes: Words | None = None
    rig: Name | None = None
    sensor: SensorSettings | None = None
    gripper: Device | None = None
    calibration_days: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """Days after which a calibration of the sensor or the rig is too old."""
    columns: Annotated[dict[str, Annotated[str, Field(max_length=20)]], Field(max_length=50)] = {}
    """The user's own columns of fruits.csv by name, with their units; without a unit they hold text."""
    pit: PitSettings = PitSettings()
    recon: Recon = Recon()
    photos: Photos = Photos()
    mesh: MeshSettings = MeshSettings()
    flesh: FleshSettings = FleshSettings()
    grading: Grading = Grading()
    reference: ReferenceSettings = ReferenceSettings()
    mismatch: Annotated[tuple[ConfirmedEffect, ...], Field(max_length=1000)] = ()

    @field_validator("temperature")
    @classmethod
    def _with_pulp(
        cls, wanted: TemperatureSettings | None, info: ValidationInfo
    ) -> TemperatureSettings | None:
        """Raises ValueError if the temperature of the pulp is missing."""
        if wanted is not None and info.data.get("pulp_temperature_C", 0.0) is None:
            raise ValueError("needs pulp_temperature_C, at which the fruit were grasped; add it above")
        return wanted

    @field_validator("calibration_days")
    @classmethod
    def _of_something(cls, days: int | None, info: ValidationInfo) -> int | None:
        """Raises ValueError without a rig and without a calibration of the sensor."""
        sensor = info.data.get("sensor")
        calibrated = sensor is not None and sensor.calibrated
        if days is not None and not calibrated and info.data.get("rig") is None:
            raise ValueError("needs a date: add calibrated_on under [sensor], or a rig")
        return days

    @field_validator("columns")
    @classmethod
    def _free_names(cls, columns: dict[str, str]) -> dict[str, str]:
        """Raises ValueError for names that drupe's settings or tables use, invalid ones, and equal ones."""
        with elsewhere():
            from pipeline.batch.firmness_columns import is_firmness_column
            from reports.tables import RANKING_COLUMNS
        columns = {composed(name): unit for name, unit in columns.items()}
        taken = (*COLUMNS, *RANKING_COLUMNS, *cls.model_fields, *HISTORY_COLUMNS)
        for name in columns:
            if not USER_COLUMN.fullmatch(name):
                raise ValueError(
                    f'"{name[:80]}" cannot name a column; start with a letter or digit, then use letters, '
                    "digits, spaces and _ . % ° # ( ) / - (at most 60)"
                )
            if (column := canonical(name, taken)) in taken or is_firmness_column(column):
                raise ValueError(f'"{name}" is the name of a column of drupe ({column}); choose another name')
        if len({canonical(name, ()) for name in columns}) < len(columns):
            raise ValueError(f"names must differ by more than capitals and spaces, found {list(columns)}")
        return columns


def settings_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of batch.toml, generated from `Settings`."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Settings.model_json_schema(),
        "title": "batch.toml of drupe",
    }

"""Results of one recording of a fruit, as in `record.json` and in the report."""

from array import array
from itertools import chain
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainSerializer, TypeAdapter

_PLACES = TypeAdapter(list[tuple[float, float, float]])


def _flat(places: Any) -> array:
    return array("d", chain.from_iterable(_PLACES.validate_python(places)))


def _in_threes(flat: array) -> list[tuple[float, float, float]]:
    coordinates = iter(flat)
    return list(zip(coordinates, coordinates, coordinates, strict=True))


Places = Annotated[array, BeforeValidator(_flat), PlainSerializer(_in_threes)]
"""Points (mm) in one flat array, in JSON lists of three. Python floats took half of a record's memory."""


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)


class ModelCurveRecord(_Record):
    """The fitted model's travel under a pad's force, in the frames used; `sd_mm`: its error due to E."""

    travel_mm: list[float]
    force_N: list[float]
    sd_mm: list[float]


class CurveRecord(_Record):
    """Normal force of one pad against travel since first touch."""

    pad: str
    travel_mm: list[float]
    force_N: list[float]
    model: ModelCurveRecord | None = None


class FrameRecord(_Record):
    """E from one frame alone, its error from the markers' noise, and whether the jaws were opening."""

    travel_mm: float
    E_MPa: float
    E_sd_MPa: float
    unloading: bool = False


class GraspRecord(_Record):
    """Results of one recording; `failure` says why there are none."""

    grasp: str
    failure: str | None = None
    digest: str = ""
    """Digest of its displacements and forces (tactile.readers.recording)."""
    E_MPa: float | None = None
    E_sd_MPa: float | None = None
    parts_sd_MPa: dict[str, float] = {}
    discretisation: float | None = None
    E_energy_MPa: float | None = None
    E_energy_sd_MPa: float | None = None
    E_least_squares_MPa: float | None = None
    E_least_squares_sd_MPa: float | None = None
    residual_um: float | None = None
    noise_um: float | None = None
    registration_mm: float | None = None
    frames_used: int | None = None
    markers_used: int | None = None
    peak_force_N: float | None = None
    """The largest normal force of any one pad in any frame: not the sum of the pads."""
    travel_mm: float | None = None
    contact_mm: dict[str, Places] = {}
    curves: list[CurveRecord] = []
    frames: list[FrameRecord] = []

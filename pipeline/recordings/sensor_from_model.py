"""`drupe sensor`: describes a commercial sensor, with the camera of the user's own copy."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.problem import refused
from pipeline.recordings.description_file import DescriptionKind
from tactile.readers.pictures import read_picture
from tactile.readers.sensor_file import read_sensor
from tactile.readers.sensor_model import SensorModel, model_names, read_model
from tactile.sensor_description import described, with_given
from tactile.tactile_failure import TactileFailure

SENSOR = DescriptionKind("# written by drupe sensor", "a description that drupe sensor wrote")


def shipped() -> tuple[SensorModel, ...]:
    """All sensors that drupe knows by name."""
    return tuple(map(read_model, model_names()))


def write_sensor(
    name: str,
    out: Path,
    *,
    picture: Path | None,
    given: Mapping[str, tuple[float, ...]],
    known_to: float,
    grid: tuple[int | None, int | None],
) -> tuple[str, ...]:
    """Writes `out`; returns a line on the source and error of each value. Raises BatchRefused for an unknown
    name, or a file that drupe sensor did not write; TactileFailure for an unusable picture or missing value.
    """
    if name not in model_names():
        known = ", ".join(model_names())
        raise refused(name, f"is not a sensor that drupe knows; known: {known}.")
    SENSOR.require_place(out, inputs=[] if picture is None else [picture])
    model = with_given(read_model(name), {key: (value, known_to) for key, value in given.items()})
    rows, columns = grid
    model = replace(model, rows=rows or model.rows, columns=columns or model.columns)
    seen = None if picture is None else read_picture(picture)
    made = described(model, seen, source="" if picture is None else picture.name)
    SENSOR.put(out, made.table, read_sensor, remarks=made.said)
    return made.said


def unknown_of(model: SensorModel) -> str:
    """A sentence on the values without a published source; empty if there are none."""
    try:
        described(model, None, source="")
    except TactileFailure as failure:
        said = str(failure).removeprefix(f"{model.name}: ")
        return f"{said[0].upper()}{said[1:]}" if said.startswith("no published values exist") else ""
    return ""

"""Commercial sensors: published values of each, with source and standard deviation.

Each has one file in tactile/sensor_models. A value is `{ value, sd, source }`; the user adds others.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from tactile.readers.toml_table import Table, read_table
from tactile.sensors import SensorKind, bonded_stiffness
from tactile.tactile_failure import TactileProblem

FOLDER = Path(__file__).parents[1] / "sensor_models"
"""Folder of the shipped files."""
_SERIAL = re.compile(r"(?:(?:sn|s/n|serial|#)[:. ]*[\w-]*\d[\w-]*)|(?!v\d)(?=[\w-]*\d)(?=[\w-]*[a-z-])[\w-]+")
"""Serial numbers in small letters: SN 20123, #7, D20123, A1-0040R. A number alone or a version (v2) may be
part of a model's name."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """A number (or two, along x and y), its standard deviation in the same unit, and its source."""

    value: Float[np.ndarray, " n"]
    sd: float
    source: str

    @property
    def relative_sd(self) -> float:
        """Standard deviation over the mean absolute value."""
        return float(self.sd / np.mean(np.abs(self.value)))


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """`gel`: by the keys of a description's [gel]; `pitch_mm`: None if the user prints the dots; `fields`:
    relative standard deviation of the maker's "force" and "displacement".
    """

    key: str
    kind: SensorKind
    name: str
    notes: str
    gel: dict[str, Published] = field(default_factory=dict)
    rows: int | None = None
    columns: int | None = None
    pitch_mm: Published | None = None
    distance_mm: Published | None = None
    fields: dict[str, Published] = field(default_factory=dict)


def model_names() -> tuple[str, ...]:
    """Keys of the shipped sensors."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def model_named(sensor: str) -> SensorModel | None:
    """The shipped sensor that a recording names by its key or its name, with or without a serial number.

    Other words behind the name belong to other sensors: DIGIT 360, DIGIT Pinki.

    >>> names = ("GelSight Mini, marked gel", "Tac3D A1-0040R", "gel")
    >>> [model and model.key for model in map(model_named, names)]
    ['gelsight-mini', 'tac3d', None]
    """
    said = _plain(sensor)
    for model in map(read_model, model_names()):
        for name in (_plain(model.key), _plain(model.name)):
            if said == name or (said.startswith(f"{name} ") and _SERIAL.fullmatch(said[len(name) + 1 :])):
                return model
    return None


def _plain(name: str) -> str:
    return " ".join(name.lower().split())


@cache
def read_model(name: str) -> SensorModel:
    """The shipped sensor of that name; raises TactileFailure (unreadable-sensor) for a wrong file."""
    path = FOLDER / f"{name}.toml"
    top = read_table(path, TactileProblem.UNREADABLE_SENSOR, what="a sensor's published values")
    top.refuse_unknown({"kind", "name", "notes", "gel", "markers", "camera", "fields"})
    markers, camera = top.table("markers", needed=False), top.table("camera", needed=False)
    return SensorModel(
        key=name,
        kind=cast(SensorKind, top.choice("kind", ("markers-mono", "fields"))),
        name=top.text("name"),
        notes=top.text("notes", default=""),
        gel=_published(top.table("gel", needed=False)),
        rows=markers.whole("rows") if markers else None,
        columns=markers.whole("columns") if markers else None,
        pitch_mm=_one(markers.values["pitch_mm"]) if markers else None,
        distance_mm=_one(camera.values["distance_mm"]) if camera else None,
        fields=_published(top.table("fields", needed=False)),
    )


def _published(table: Table) -> dict[str, Published]:
    return {name: _one(said) for name, said in table.values.items()}


def _one(said: Any) -> Published:
    return Published(
        value=np.atleast_1d(np.asarray(said["value"], dtype=np.float64)),
        sd=float(said["sd"]),
        source=str(said["source"]),
    )


@dataclass(frozen=True, kw_only=True)
class PublishedGel:
    """Published values of a gel, from `source`. `stiffness`: by the name of a pad's attribute, the value
    (MPa/mm) and its relative standard deviation. `pitch_mm`: geometric mean of both steps of the grid;
    `pitch_sd`: its relative standard deviation.
    """

    source: str
    stiffness: Mapping[str, tuple[float, float]]
    pitch_mm: float | None = None
    pitch_sd: float = 0.0


def gel_of_model(model: SensorModel) -> PublishedGel:
    """The gel's stiffness and pitch from published values.

    An unpublished stiffness is that of the bonded layer (tactile.sensors), with errors to first order.
    """
    pitch, names = model.pitch_mm, ("gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm")
    measured = {name: model.gel[name] for name in names if name in model.gel}
    stated = {name: (float(known.value[0]), known.relative_sd) for name, known in measured.items()}
    return PublishedGel(
        source=f'the sensor model "{model.key}"',
        stiffness=_of_a_layer(model.gel) | stated,
        pitch_mm=None if pitch is None else float(np.exp(np.log(pitch.value).mean())),
        pitch_sd=0.0 if pitch is None else pitch.relative_sd,
    )


def _of_a_layer(gel: Mapping[str, Published]) -> dict[str, tuple[float, float]]:
    """Both stiffnesses of a bonded layer; none unless modulus, Poisson's ratio and thickness are known."""
    if not {"E_MPa", "nu", "thickness_mm"} <= gel.keys():
        return {}
    E, nu, h = (float(gel[name].value[0]) for name in ("E_MPa", "nu", "thickness_mm"))
    nu_sd, scale_sd = gel["nu"].sd, np.hypot(gel["E_MPa"].relative_sd, gel["thickness_mm"].relative_sd)
    kn, kt = bonded_stiffness(E, nu, h)
    of_kn, of_kt = 2 / (1 - 2 * nu) - 1 / (1 - nu) - 1 / (1 + nu), 1 / (1 + nu)
    return {
        "gel_kn_MPa_per_mm": (kn, float(np.hypot(scale_sd, of_kn * nu_sd))),
        "gel_kt_MPa_per_mm": (kt, float(np.hypot(scale_sd, of_kt * nu_sd))),
    }

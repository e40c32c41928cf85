"""Geometry of a bare indenter's curve: options, its recording's fields, case.toml or fruits.csv."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Literal, TypeAlias

from fem.indentation.ball import Ball
from fem.indentation.compressed_cylinder import Cylinder
from fem.indentation.compressed_ellipsoid import LARGEST_PIT, Ellipsoid
from fem.indentation.contact_curve import Geometry
from fem.indentation.flat_punch import FlatPunch
from pipeline.batch.fruits_table import Given
from pipeline.problem import refused
from tactile.readers.specimen import DIAMETERS, PressedSpecimen, SpecimenKind

Indenter: TypeAlias = Literal["ball", "flat", "plate"]

OF_SLABS = frozenset({"thickness_mm"})
OF_CYLINDERS = frozenset({"kind", "height_mm", "diameter_mm", "ends"})
OF_FRUIT = frozenset({"kind", "diameters_mm", "axis", "pit_share"})
NEEDED: dict[SpecimenKind, tuple[str, ...]] = {
    "cylinder": ("height_mm", "diameter_mm"),
    "fruit": ("diameters_mm", "axis"),
}
"""Fields of a specimen between plates without which no force can be computed."""
KEYS = {f.name: f.name for f in fields(PressedSpecimen)} | {"kind": "specimen"}
"""Names of a PressedSpecimen's fields in case.toml."""
COLUMNS = KEYS | {
    "diameters_mm": "columns diameter_a_mm, diameter_b_mm, diameter_c_mm",
    "axis": "column axis",
    "pit_share": "column pit_share",
}
"""Their names in fruits.csv, which has columns only for fruit."""
OPTIONS = {name: f"--{key.replace('_', '-')}" for name, key in KEYS.items()}
"""Their names in `drupe convert`."""
EXAMPLES = {"height_mm": "12", "diameter_mm": "15", "diameters_mm": "61 60 58", "axis": "a|b|c"}
"""Example values of each, for messages."""


@dataclass(frozen=True, kw_only=True)
class TraceGeometry:
    """The geometry, the slab's thickness under a ball or punch, and notes on both; `assumed`: notes on values
    that nobody stated and the category gives. Two are equal if one law holds for both.
    """

    geometry: Geometry
    thickness_mm: float | None
    notes: tuple[str, ...] = field(default=(), compare=False)
    assumed: tuple[str, ...] = field(default=(), compare=False)

    @property
    def of_slab(self) -> bool:
        """Whether a ball or punch presses on it, so that its thickness matters."""
        return self.geometry.tool != "plate"


@dataclass(frozen=True, kw_only=True)
class Stated:
    """The user's statements about the specimen, in the file `where`, which calls its fields `name_of`."""

    specimen: PressedSpecimen
    where: str
    name_of: Mapping[str, str]


def stated_in_table(given: Given) -> Stated:
    """The statements of fruits.csv about a fruit between plates."""
    diameters = tuple(
        diameter_mm
        for diameter_mm in (given.diameter_a_mm, given.diameter_b_mm, given.diameter_c_mm)
        if diameter_mm is not None
    )
    specimen = PressedSpecimen(
        kind="fruit" if diameters else None,
        diameters_mm=(diameters[0], diameters[1], diameters[2]) if len(diameters) == 3 else None,
        axis=given.axis,
        pit_share=given.pit_share,
    )
    return Stated(specimen=specimen, where="fruits.csv", name_of=COLUMNS)


def combined(recorded: PressedSpecimen, stated: Stated, *, source: str) -> tuple[PressedSpecimen, list[str]]:
    """The recording's specimen with the stated fields in place of its own, and a note on each difference."""
    recorded_by_name, said = recorded.stated, stated.specimen.stated
    notes = [
        f"{source}: {KEYS[name]} is {recorded_by_name[name]} in the recording but {value} in {stated.where}; "
        "drupe uses the latter."
        for name, value in said.items()
        if name in recorded_by_name and recorded_by_name[name] != value
    ]
    return replace(recorded, **said), notes


def geometry_of(
    indenter: Indenter,
    radius_mm: float | None,
    specimen: PressedSpecimen,
    *,
    source: str,
    name_of: Mapping[str, str],
    pit_share: float | None = None,
) -> TraceGeometry:
    """Geometry of indenter and specimen; `name_of` fields for users (OPTIONS or KEYS), `pit_share` of the
    category.

    Raises BatchRefused that names missing and foreign fields, and what to give.
    """
    if indenter in ("ball", "flat"):
        _require_none(specimen, OF_SLABS, source, name_of, f"a {indenter} on a slab")
        if radius_mm is None:
            tip = "ball" if indenter == "ball" else "punch"
            raise refused(source, f"needs the radius of the {tip}; give --radius-mm.")
        tool: Geometry = Ball(radius_mm=radius_mm) if indenter == "ball" else FlatPunch(radius_mm=radius_mm)
        return TraceGeometry(geometry=tool, thickness_mm=specimen.thickness_mm)
    kind = specimen.kind or _kind_of(specimen)
    if kind is None:
        ways = " or ".join(
            f"{name_of['kind']} {specimen_kind} with {_ways(NEEDED[specimen_kind], name_of)}"
            for specimen_kind in NEEDED
        )
        raise refused(source, f"does not name the specimen between the plates; give {ways}.")
    _require_none(specimen, OF_CYLINDERS if kind == "cylinder" else OF_FRUIT, source, name_of, f"a {kind}")
    missing = [name for name in NEEDED[kind] if name not in specimen.stated]
    if missing:
        ways = _ways(missing, name_of)
        raise refused(source, f"does not fully describe the {kind} between the plates; give {ways}.")
    if specimen.height_mm is not None and specimen.diameter_mm is not None:
        size = {"diameter_mm": specimen.diameter_mm, "height_mm": specimen.height_mm}
        return TraceGeometry(geometry=Cylinder(**size, ends=specimen.ends), thickness_mm=None)
    return _fruit(specimen, pit_share, name_of)


def _fruit(specimen: PressedSpecimen, pit_share: float | None, name_of: Mapping[str, str]) -> TraceGeometry:
    """The pit's share is the specimen's own, else the category's, else none; a note names the last two."""
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    share = specimen.pit_share
    if share is None and pit_share is not None:
        share = min(pit_share, LARGEST_PIT)
        assumed = (
            f"No {name_of['pit_share']} given: drupe uses the category's pit, {share:.2f} of the "
            "fruit's diameter.",
        )
    elif share is None:
        share = 0.0
        notes = (
            f"No {name_of['pit_share']} given, and the category has none: drupe assumes solid flesh, "
            "so a fruit with a stone appears stiffer.",
        )
    geometry = Ellipsoid(
        diameters_mm=specimen.diameters_mm or (0.0, 0.0, 0.0),
        axis=DIAMETERS.index(specimen.axis or "a"),
        pit_share=share,
    )
    return TraceGeometry(geometry=geometry, thickness_mm=None, notes=notes, assumed=assumed)


def _kind_of(specimen: PressedSpecimen) -> SpecimenKind | None:
    if specimen.diameters_mm is not None:
        return "fruit"
    return "cylinder" if specimen.height_mm is not None or specimen.diameter_mm is not None else None


def _require_none(
    specimen: PressedSpecimen, allowed: frozenset[str], source: str, name_of: Mapping[str, str], what: str
) -> None:
    strange = [name_of[name] for name in specimen.stated if name not in allowed]
    if strange:
        known = ", ".join(name_of[name] for name in name_of if name in allowed)
        said = f"gives {', '.join(strange)} for {what}, which has only {known}; remove it."
        raise refused(source, said)


def _ways(names: Sequence[str], name_of: Mapping[str, str]) -> str:
    return ", ".join(f"{name_of[name]} {EXAMPLES[name]}" for name in names)

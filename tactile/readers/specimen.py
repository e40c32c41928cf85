"""The specimen under a bare indenter, as its recording states it: lengths in mm, None if not stated."""

from dataclasses import dataclass, fields
from typing import Any, Literal, TypeAlias, cast

from tactile.readers.recording_fields import GroupReader, Limit

SpecimenKind: TypeAlias = Literal["cylinder", "fruit"]
SpecimenEnds: TypeAlias = Literal["bonded", "lubricated"]
Axis: TypeAlias = Literal["a", "b", "c"]
LENGTH = Limit(500.0, "millimetres (is it in m or µm?)", least=0.01)
"""Length of any specimen: the largest is ten times the largest fruit's, the least a film's."""
DIAMETERS: tuple[Axis, ...] = ("a", "b", "c")


@dataclass(frozen=True, kw_only=True)
class PressedSpecimen:
    """A slab (`thickness_mm`), or a cylinder (`height_mm`, `diameter_mm`, `ends`) or fruit between plates. A
    fruit has diameters a, b, c (`diameters_mm`) and is compressed along one of them (`axis`). `pit_share`:
    the pit's diameter over the fruit's.
    """

    kind: SpecimenKind | None = None
    thickness_mm: float | None = None
    height_mm: float | None = None
    diameter_mm: float | None = None
    ends: SpecimenEnds | None = None
    diameters_mm: tuple[float, float, float] | None = None
    axis: Axis | None = None
    pit_share: float | None = None

    @property
    def stated(self) -> dict[str, Any]:
        """The stated facts, by field."""
        return {f.name: value for f in fields(self) if (value := getattr(self, f.name)) is not None}


def read_specimen(pad: GroupReader) -> PressedSpecimen:
    """The specimen in a pad's attributes, which are all optional; raises TactileFailure for wrong values."""
    diameters = tuple(pad.optional_positive(f"diameter_{name}_mm", limit=LENGTH) for name in DIAMETERS)
    if any(diameter is not None for diameter in diameters):
        diameters = tuple(pad.positive(f"diameter_{name}_mm", limit=LENGTH) for name in DIAMETERS)
    has = pad.group.attrs
    return PressedSpecimen(
        kind=cast(SpecimenKind, pad.choice("specimen", {"cylinder", "fruit"})) if "specimen" in has else None,
        thickness_mm=pad.optional_positive("thickness_mm", limit=LENGTH),
        height_mm=pad.optional_positive("height_mm", limit=LENGTH),
        diameter_mm=pad.optional_positive("diameter_mm", limit=LENGTH),
        ends=cast(SpecimenEnds, pad.choice("ends", {"bonded", "lubricated"})) if "ends" in has else None,
        diameters_mm=None if diameters[0] is None else cast(tuple[float, float, float], diameters),
        axis=cast(Axis, pad.choice("axis", set(DIAMETERS))) if "axis" in has else None,
        pit_share=pad.share("pit_share") if "pit_share" in has else None,
    )


def write_specimen(attributes: Any, specimen: PressedSpecimen) -> None:
    """Writes the specimen into a pad's attributes, so that `read_specimen` returns it."""
    said = specimen.stated
    if "kind" in said:
        said["specimen"] = said.pop("kind")
    for name, value in zip(DIAMETERS, said.pop("diameters_mm", ()), strict=False):
        said[f"diameter_{name}_mm"] = value
    attributes.update(said)

"""Contradictions in a fruit's inputs although E could be computed, and how far they widen E's error bar."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float, Int

from fem.estimation.modulus import ModulusSign, ModulusWarning
from pipeline.fruit.placed_grasp import PlacedGrasp
from recon.pit.priors import PitPrior
from recon.triangle_mesh import volume_mm3
from tactile.consistency.finding import Field, Finding, FindingKind

FAR_SD, FAR_SHARE = 5.0, 0.08
"""A given pit is reported as displaced beyond this many of the prior's standard deviations, and beyond this
share of the fruit's half width: 2.5 mm for a nectarine. Valid ones lie within 0.4 mm and 0.013 of it
(benchmarks/field_spreads.py, "pit.ply from its category's place"; six pits). Assumed larger, since real
stones sit within 0.5 mm (sd) of their category's place, by estimate."""
FAR_REFUSED = 0.25
"""Refused share of it; assumed: no stone of a whole fruit lies there."""
SIZE_SAID, SIZE_SD, SIZE_REFUSED = 0.18, 4.0, 0.45
"""|ln| of a given pit's size over its category's above which it is reported, if at least this many of the
prior's standard deviations, and refused. Valid ones have 0.02 (field_spreads.py, "pit.ply, |ln size|").
Assumed: three times the spread of stones of one kind, 0.03 to 0.06 (sd), and half again or two thirds as
large."""
TURNED = 0.5
"""Greatest minus least ln(side over the category's) of the three axes: a rotated pit has its longest side
elsewhere. Valid ones have 0.12 (field_spreads.py, "pit.ply, spread of ln sides"). A quarter turn of the
category's pit about x, y, z makes 1.06, 0.36, 0.71 for a nectarine, 0.44, 0.07, 0.37 for a cherry. Assumed,
so that no valid pit of other proportions is reported; rotations of round stones stay undetected."""
E_PER_MM = 0.01
"""Relative error of E per mm of the pit's offset. E of two nectarines changed by 0.0002 to 0.0054 per mm,
median 0.0022, over 6 mm along x, y, z and towards a pad (graded with the pit moved; a third by 0.0035). This
is twice the greatest: E changes faster the nearer the pit is to a pad, at 6 mm by 0.004 to 0.011 per mm."""
E_PER_SIZE = 0.6
"""The same per ln of the pit's size: 0.51 at 1.4 times (field_mistakes.py --grade --only "pit x", a
nectarine), and 0.19 to 0.41 at 1.3 and 1/1.3 times (two nectarines and a plum)."""
E_OF_A_TURNED_PIT = 0.1
"""Relative standard deviation of E: a quarter turn about z or x changed E by 0.01 to 0.07 (two nectarines and
a plum); assumed half as much again, for pads that meet other sides of the pit."""
DOUBTED = "doubts about the inputs"
"""The part of an error bar that comes from contradictions in a recording or a given pit."""
_NO_WORK, _METHODS = ModulusSign.NO_WORK, ModulusSign.METHODS_APART
_RESIDUAL, _UNBALANCED = ModulusSign.RESIDUAL, ModulusSign.UNBALANCED
_PHASES = ModulusSign.PHASES_APART
_FORCE_LOST = frozenset({_METHODS, _RESIDUAL, _UNBALANCED})
_GAIN = frozenset({_METHODS, _RESIDUAL, _UNBALANCED, _PHASES})
_ELSEWHERE = frozenset({_METHODS, _RESIDUAL})
_TRAVEL = frozenset({_NO_WORK, _METHODS, _RESIDUAL, _PHASES})
_BEFORE = frozenset({_METHODS, _RESIDUAL, _PHASES})
_Kind = FindingKind
EXPLAINS: Mapping[FindingKind, frozenset[ModulusSign]] = {
    # part of a pad's force is missing or wrong: the pads do not balance and no linear body fits
    **dict.fromkeys((_Kind.DEAD_MARKERS, _Kind.MARKERS_MISSING, _Kind.CLIPPED), _FORCE_LOST),
    **dict.fromkeys((_Kind.NO_TARE, _Kind.REFERENCE_PRINT), _FORCE_LOST),
    # a gain may affect one pad alone, and may be a creeping gel
    **dict.fromkeys((_Kind.SCALE, _Kind.FORCE_DRIFT), _GAIN),
    # noise delays the first touch found; the residual is compared with the noise itself
    _Kind.NOISE: frozenset({_NO_WORK, _METHODS, _UNBALANCED, _PHASES}),
    # the gel's places relative to the jaws are wrong, or the jaws' travel relative to the fruit's
    # deformation; the forces of the two pads still belong to one instant
    **dict.fromkeys((_Kind.CLOCKS_APART, _Kind.APERTURE, _Kind.STIFFER_THAN_RIG), _TRAVEL),
    _Kind.STARTS_IN_CONTACT: _BEFORE,
    # the pads touched elsewhere, or another fruit: their signals are balanced and simultaneous
    **dict.fromkeys(
        (_Kind.WIDTH, _Kind.ASIDE, _Kind.PRINT_ASIDE, _Kind.PADS_EXCHANGED, _Kind.MESH_TURNED), _ELSEWHERE
    ),
    **dict.fromkeys((_Kind.OTHER_FRUIT, _Kind.OTHER_CATEGORY), _ELSEWHERE),
}
"""Signs in a recording's modulus that follow from a finding in it: only these are left out if it is reported.
Other kinds explain none: E does not depend on them, they scale all forces by one factor, or they refuse the
recording."""


def expected_E_MPa(prior: PitPrior | None) -> tuple[float, float] | None:
    """The lowest and the highest E of the category's flesh; None if its file does not state them."""
    return None if prior is None or prior.plausible is None else prior.plausible.E_MPa


def implausible_E(values_MPa: Mapping[str, float], prior: PitPrior | None) -> str | None:
    """A sentence that names the values outside the category's range of E; None if all are within it."""
    limits = expected_E_MPa(prior)
    if prior is None or limits is None:
        return None
    wrong = [f"{name} {E:.3g} MPa" for name, E in values_MPa.items() if not limits[0] <= E <= limits[1]]
    if not wrong:
        return None
    return (
        f"Found {' and '.join(wrong)}, expected {limits[0]:g} to {limits[1]:g} MPa for "
        f"{prior.category}; check units and factors of forces, travel, displacements and sizes."
    )


class PitKind(StrEnum):
    """Doubts about a given pit."""

    AWAY = "pit-away"
    SIZE = "pit-size"
    TURNED = "pit-turned"


class CategoryKind(StrEnum):
    """Values that belong to another category than the batch's."""

    POISSON_RATIO = "poisson-ratio-of-category"
    SIZE = "size-of-category"


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """A sentence with the cause, and the relative standard deviation that it adds to E.

    `kind`, `field` and `pads` determine whether two recordings have the same fault (`relative_sd`); a doubt
    without a kind shares its cause with no other.
    """

    sentence: str
    relative_sd: float = 0.0
    refused: bool = False
    kind: FindingKind | PitKind | CategoryKind | None = None
    field: Field | None = None
    pads: tuple[str, ...] = ()


def of_grasps(grasps: Sequence[PlacedGrasp]) -> list[Doubt]:
    """The doubts of the recordings used; each counts by its recording's share of them."""
    return of_findings([(grasp.name, grasp.findings) for grasp in grasps])


def of_findings(recordings: Sequence[tuple[str, Sequence[Finding]]]) -> list[Doubt]:
    """The doubts of each recording's findings, by its name."""
    return [
        Doubt(
            sentence=f"{name}: {finding.sentence}.",
            relative_sd=finding.relative_sd / len(recordings),
            kind=finding.kind,
            field=finding.field,
            pads=finding.pads,
        )
        for name, findings in recordings
        for finding in findings
        if not finding.remark
    ]


def remarks_of_grasps(grasps: Sequence[PlacedGrasp]) -> list[str]:
    """Remarks on the recordings that cast no doubt."""
    return [
        f"{grasp.name}: {finding.sentence}."
        for grasp in grasps
        for finding in grasp.findings
        if finding.remark
    ]


def signs_explained(grasp: PlacedGrasp) -> frozenset[ModulusSign]:
    """The signs in the recording's modulus that follow from its findings."""
    named = (EXPLAINS.get(finding.kind, ()) for finding in grasp.findings if not finding.remark)
    return frozenset[ModulusSign]().union(*named)


def causes_alone(grasp: PlacedGrasp, warnings: Sequence[ModulusWarning]) -> list[ModulusWarning]:
    """`warnings` without the signs that follow from a named cause."""
    explained = signs_explained(grasp)
    return [warning for warning in warnings if warning.sign not in explained]


def relative_sd(doubts: Sequence[Doubt]) -> float:
    """Total of all doubts: sqrt(sum over causes of (sum over recordings of sd)^2).

    A fault of one kind, field and pads is the same in every recording that has it (a gain, another gel's
    stiffness, a clock). More recordings do not reduce it, so its parts add linearly; with each recording's
    share of E (`of_grasps`) they make their mean. Independent causes add in squares.
    """
    by_cause: dict[object, float] = defaultdict(float)
    for number, doubt in enumerate(doubts):
        cause = number if doubt.kind is None else (doubt.kind, doubt.field, doubt.pads)
        by_cause[cause] += doubt.relative_sd
    return float(np.linalg.norm(list(by_cause.values()))) if by_cause else 0.0


@dataclass(frozen=True, kw_only=True)
class PitAgainstCategory:
    """A pit against its category's in a fruit of this size: its offset, and ln of its size and sides.

    `half_mm`: mean half width of the fruit; `sides` are ln(side over the category's) along x, y, z.
    """

    off_mm: float
    half_mm: float
    size: float
    sides: Float[np.ndarray, " 3"]


def against_category(
    vertices: Float[np.ndarray, "n 3"],
    pit_vertices: Float[np.ndarray, "m 3"],
    pit_faces: Int[np.ndarray, "k 3"],
    prior: PitPrior,
) -> PitAgainstCategory | None:
    """How a pit differs from its category's; None for a category whose bodies may have theirs anywhere."""
    if prior.axis_ratios is None:
        return None
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    half = (high - low) / 2
    pit_low, pit_high = pit_vertices.min(axis=0), pit_vertices.max(axis=0)
    expected = (low + high) / 2 + np.asarray(prior.raised) * half
    usual = np.asarray(prior.axis_ratios) * half
    ellipsoid_mm3 = 4 / 3 * np.pi * float(usual.prod())
    return PitAgainstCategory(
        off_mm=float(np.linalg.norm((pit_low + pit_high) / 2 - expected)),
        half_mm=float(half.mean()),
        size=float(np.log(abs(volume_mm3(pit_vertices, pit_faces)) / ellipsoid_mm3)) / 3,
        sides=np.asarray(np.log((pit_high - pit_low) / 2 / usual)),
    )


def of_a_given_pit(
    vertices: Float[np.ndarray, "n 3"],
    pit_vertices: Float[np.ndarray, "m 3"],
    pit_faces: Int[np.ndarray, "k 3"],
    prior: PitPrior | None,
) -> list[Doubt]:
    """Doubts about a pit.ply that is unlike the category's: moved, scaled, turned. Empty without a prior.

    A category whose bodies may have their pit anywhere (`axis_ratios` unknown) is not judged.
    """
    pit = None if prior is None else against_category(vertices, pit_vertices, pit_faces, prior)
    if prior is None or pit is None:
        return []
    off, size, sides = pit.off_mm, pit.size, pit.sides
    doubts = []
    if off > max(FAR_SD * prior.offset_sd_mm, FAR_SHARE * pit.half_mm):
        doubts.append(
            Doubt(
                kind=PitKind.AWAY,
                sentence=(
                    f"pit.ply lies {off:.1f} mm from the expected place of a {prior.category}'s pit "
                    "(the fruit's middle). The mesh in pit.ply is shifted, uses another frame than "
                    "fruit.ply, or is another fruit's."
                ),
                relative_sd=E_PER_MM * off,
                refused=off > FAR_REFUSED * pit.half_mm,
            )
        )
    if abs(size) > max(SIZE_SAID, SIZE_SD * prior.size_sd):
        doubts.append(
            Doubt(
                kind=PitKind.SIZE,
                sentence=(
                    f"pit.ply is {np.exp(size):.2f} times the expected size of a {prior.category}'s "
                    "pit in a fruit of this size. The mesh in pit.ply is scaled, uses another unit, "
                    "or is another fruit's."
                ),
                relative_sd=E_PER_SIZE * abs(size),
                refused=abs(size) > SIZE_REFUSED,
            )
        )
    elif float(np.ptp(sides)) > TURNED:
        longest = "xyz"[int(np.argmax(sides))]
        doubts.append(
            Doubt(
                kind=PitKind.TURNED,
                sentence=(
                    f"pit.ply is too long along {longest} for a {prior.category}'s pit "
                    f"({np.exp(sides.max()):.2f} times, elsewhere {np.exp(sides.min()):.2f} times). "
                    "It is rotated relative to fruit.ply, or is another fruit's."
                ),
                relative_sd=E_OF_A_TURNED_PIT,
            )
        )
    return doubts

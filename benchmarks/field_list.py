"""The mistakes of the field that field_mistakes.py makes, and which findings name each."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from field_changes import (
    DISPLACEMENT,
    FORCE,
    Change,
    arrays,
    both,
    clipped,
    cut,
    dead,
    each,
    exchanged,
    force,
    frames,
    from_contact,
    gel,
    hole,
    in_order,
    late,
    mesh,
    noisy,
    offset,
    other_mesh,
    other_poses,
    other_recording,
    pads,
    permuted,
    picture_scale,
    pit,
    pose,
    rounded,
    scaled_place,
    shift,
    some,
    standing_still,
    stated,
    transposed,
    until_peak,
    without_markers,
    zero_frames,
)
from field_changes import (
    about_the_middle as middled,
)

from pipeline.fruit.input_doubts import CategoryKind, PitKind
from tactile.checks.finding import Field, FindingKind

Said = FindingKind | PitKind | CategoryKind


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """A change, and what names it.

    `kinds`: findings whose cause this is, if they are of its `field` and its `unit`; `among`: findings whose
    sentence lists this cause among others. `harmless`: E does not depend on it. `covered`: no check needs to
    name it, and E is within two of its standard deviations.
    """

    name: str
    change: Change
    kinds: AbstractSet[Said]
    among: AbstractSet[Said] = frozenset()
    field: Field | None = None
    unit: str = ""
    harmless: bool = False
    covered: bool = False


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One thing that is said of a fruit; `detail` as in tactile.checks.finding (of a unit: the unit)."""

    kind: Said
    sentence: str
    field: Field | None = None
    detail: str = ""
    refused: bool = False
    remark: bool = False


def naming(first: Answer | None, mistake: Mistake) -> Literal["named", "among several", ""]:
    """How what stands first names the mistake.

    A finding of its kind that leaves the field or the unit open lists it among others; one of another field
    or unit does not name it.
    """
    if first is None:
        return ""
    if first.kind not in mistake.kinds:
        return "among several" if first.kind in mistake.among else ""
    said = [
        ({first.field} - {None}, mistake.field),
        (set(first.detail.split(" or ")) - {""}, mistake.unit),
    ]
    if any(wanted and of and wanted not in of for of, wanted in said):
        return ""
    return "named" if all(not wanted or of == {wanted} for of, wanted in said) else "among several"


TURN_90 = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
TILT_90 = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRROR = np.diag([-1.0, 1, 1])

A_UNIT_OF_FORCE = {FindingKind.FORCE_UNIT, FindingKind.FORCE_OR_STIFFNESS_UNIT}
A_UNIT_OF_STIFFNESS = {FindingKind.STIFFNESS_UNIT, FindingKind.FORCE_OR_STIFFNESS_UNIT}
GAIN, OVER_EDGE = {FindingKind.GAIN}, {FindingKind.OVER_EDGE}
MISSING, DEAD = {FindingKind.MARKERS_MISSING}, {FindingKind.DEAD_MARKERS}
NOT_OF_SENSOR = {FindingKind.STIFFNESS_NOT_OF_SENSOR}
ASIDE = {FindingKind.ASIDE, FindingKind.PRINT_ASIDE}
CLIPPING = {FindingKind.CLIPPED, FindingKind.SATURATION}
PLACES = {FindingKind.WIDTH, FindingKind.ASIDE, FindingKind.PRINT_ASIDE}
OF_A_TURNED_MESH = PLACES | {FindingKind.PADS_EXCHANGED}
OF_OTHER_POSES = PLACES | {
    FindingKind.MESH_TURNED,
    FindingKind.POSES_STILL,
    FindingKind.POSES_TURNED,
    FindingKind.APERTURE,
    FindingKind.TOO_DEEP,
}
OF_ANOTHER_FRUIT = PLACES | {FindingKind.PADS_EXCHANGED, FindingKind.MESH_TURNED}
MISTAKES: tuple[Mistake, ...] = (
    Mistake(name="force in grams", change=force(101.97), kinds=A_UNIT_OF_FORCE, among=GAIN, unit="grams"),
    Mistake(name="force in kN", change=force(1e-3), kinds=A_UNIT_OF_FORCE, among=GAIN, unit="kilonewtons"),
    Mistake(name="force in mN", change=force(1e3), kinds=A_UNIT_OF_FORCE, among=GAIN, unit="millinewtons"),
    Mistake(name="force in pounds", change=force(0.22481), kinds=A_UNIT_OF_FORCE, among=GAIN, unit="pounds"),
    Mistake(name="force x 1.3", change=force(1.3), kinds={FindingKind.FORCE_SCALE}, among=GAIN),
    Mistake(name="force sign", change=force(-1.0), kinds={FindingKind.SIGN}, field="force"),
    Mistake(
        name="one pad's force in grams",
        change=force(101.97, only=0),
        kinds=A_UNIT_OF_FORCE,
        among=GAIN,
        unit="grams",
    ),
    Mistake(
        name="one pad's force x 0.5",
        change=force(0.5, only=1),
        kinds={FindingKind.FORCE_SCALE},
        among=GAIN,
    ),
    Mistake(
        name="force x and z exchanged",
        change=arrays(lambda p, r: lambda v: in_order(v, (2, 1, 0)), FORCE),
        kinds={FindingKind.AXES},
        field="force",
    ),
    Mistake(name="force 5 frames late", change=late("force", 5), kinds={FindingKind.DELAY}),
    Mistake(name="force 2 frames early", change=late("force", -2), kinds={FindingKind.DELAY}),
    Mistake(name="force clipped at half", change=clipped("force", 0.5), kinds=CLIPPING, field="force"),
    Mistake(name="force clipped at 80 %", change=clipped("force", 0.8), kinds=CLIPPING, field="force"),
    Mistake(name="force offset, no tare", change=offset(0.3), kinds={FindingKind.NO_TARE}, harmless=True),
    Mistake(name="force in 6 steps", change=rounded(6), kinds={FindingKind.COARSE_STEPS}, field="force"),
    Mistake(
        name="displacement in metres",
        change=shift(1e-3),
        kinds={FindingKind.DISPLACEMENT_UNIT},
        among=GAIN | {FindingKind.TOO_DEEP},
        unit="metres",
    ),
    Mistake(
        name="displacement in micrometres",
        change=shift(1e3),
        kinds={FindingKind.DISPLACEMENT_UNIT},
        among=GAIN | {FindingKind.TOO_DEEP},
        unit="micrometres",
    ),
    Mistake(name="displacement sign", change=shift(-1.0), kinds={FindingKind.SIGN}, field="displacement"),
    Mistake(
        name="displacement x 0.5",
        change=shift(0.5),
        kinds={FindingKind.DISPLACEMENT_SCALE},
        among=GAIN | {FindingKind.TOO_DEEP},
    ),
    Mistake(
        name="displacement x and z exchanged",
        change=arrays(lambda p, r: lambda v: in_order(v, (2, 1, 0)), DISPLACEMENT),
        kinds={FindingKind.AXES},
        field="displacement",
    ),
    Mistake(
        name="displacement as increments",
        change=arrays(lambda p, r: lambda v: np.diff(v, axis=0, prepend=v[:1]), DISPLACEMENT),
        kinds={FindingKind.INCREMENTS},
    ),
    Mistake(
        name="one pad's displacement dead",
        change=shift(0.0, only=0),
        kinds={FindingKind.DEAD_FIELD, FindingKind.DEAD_MARKERS},
        field="displacement",
    ),
    Mistake(
        name="displacement clipped at half",
        change=clipped("displacement", 0.5),
        kinds=CLIPPING,
        field="displacement",
    ),
    Mistake(
        name="displacement's markers permuted",
        change=permuted("displacement"),
        kinds={FindingKind.OTHER_MARKERS},
    ),
    Mistake(name="force's markers permuted", change=permuted("force"), kinds={FindingKind.OTHER_MARKERS}),
    Mistake(name="rest places permuted", change=permuted("rest"), kinds={FindingKind.MARKERS_ORDER}),
    Mistake(
        name="rest places in metres",
        change=pads(lambda p, r: replace(p, rest_mm=p.rest_mm * 1e-3)),
        kinds={FindingKind.MARKERS_UNIT},
        unit="metres",
    ),
    Mistake(
        name="30 % of markers missing",
        change=without_markers(lambda p, r: some(len(p.rest_mm), 0.3, r)),
        kinds=MISSING,
        among=OVER_EDGE,
    ),
    Mistake(name="a hole in the markers", change=without_markers(hole), kinds=MISSING, among=OVER_EDGE),
    Mistake(
        name="half of the markers missing",
        change=without_markers(lambda p, r: p.rest_mm[:, 0] > 0.2),
        kinds=MISSING,
        among=OVER_EDGE,
    ),
    Mistake(name="30 % zero throughout", change=dead(0.3, "zero"), kinds=DEAD),
    Mistake(name="30 % zero from the middle", change=dead(0.3, "zero-late"), kinds=DEAD),
    Mistake(name="30 % frozen from the middle", change=dead(0.3, "frozen"), kinds=DEAD),
    Mistake(name="10 % frozen in force", change=dead(0.1, "frozen", "force"), kinds=DEAD),
    Mistake(name="noise x 10", change=noisy(10.0), kinds={FindingKind.NOISE}, harmless=True),
    Mistake(name="one frame of zeros", change=zero_frames(1), kinds={FindingKind.ZERO_FRAMES}),
    Mistake(name="three frames of zeros", change=zero_frames(3), kinds={FindingKind.ZERO_FRAMES}),
    Mistake(
        name="gel frames shuffled",
        change=frames(lambda n, r: r.permutation(n), log=False),
        kinds={FindingKind.GEL_FRAMES_SHUFFLED},
        among={FindingKind.OUT_OF_STEP},
    ),
    Mistake(
        name="all frames shuffled",
        change=frames(lambda n, r: r.permutation(n), log=True),
        kinds={FindingKind.FRAMES_SHUFFLED},
    ),
    Mistake(
        name="every second frame a copy",
        change=frames(lambda n, r: np.arange(n) // 2 * 2, log=False),
        kinds={FindingKind.COPIED_FRAMES},
        harmless=True,
    ),
    Mistake(
        name="every third frame dropped",
        change=cut(lambda recording: np.flatnonzero(np.arange(len(recording.time_s)) % 3 != 2)),
        kinds={FindingKind.FRAMES_DROPPED},
        harmless=True,
    ),
    Mistake(name="no first touch", change=cut(from_contact), kinds={FindingKind.STARTS_IN_CONTACT}),
    Mistake(name="no unloading", change=cut(until_peak), kinds={FindingKind.ENDS_PRESSED}, harmless=True),
    Mistake(name="gel 5 frames late on jaws", change=late("both", 5), kinds={FindingKind.CLOCKS_APART}),
    Mistake(
        name="time in ms",
        change=each(lambda o, r: replace(o, time_s=o.time_s * 1e3)),
        kinds={FindingKind.TIME_UNIT},
        harmless=True,
    ),
    Mistake(
        name="aperture in cm",
        change=each(lambda o, r: replace(o, aperture_mm=o.aperture_mm / 10)),
        kinds={FindingKind.APERTURE_UNIT},
        unit="centimetres",
        harmless=True,
    ),
    Mistake(
        name="stiffness in kPa/mm",
        change=gel(1e3),
        kinds=A_UNIT_OF_STIFFNESS,
        unit="kPa/mm (or MPa/m)",
        among=GAIN,
        harmless=True,
    ),
    Mistake(name="stiffness of another gel", change=gel(2.2), kinds=NOT_OF_SENSOR, among=GAIN, harmless=True),
    Mistake(name="stiffness and force x 2", change=both(gel(2.0), force(2.0)), kinds=NOT_OF_SENSOR),
    Mistake(name="stiffness and force x 0.5", change=both(gel(0.5), force(0.5)), kinds=NOT_OF_SENSOR),
    Mistake(name="picture scale 1.1", change=picture_scale(1.1), kinds={FindingKind.PITCH_NOT_OF_SENSOR}),
    Mistake(name="picture scale 0.9", change=picture_scale(0.9), kinds={FindingKind.PITCH_NOT_OF_SENSOR}),
    Mistake(
        name="picture scale 1.1, sensor unknown",
        change=picture_scale(1.1, sensor="own gel"),
        kinds=set(),
        covered=True,
    ),
    Mistake(
        name="picture scale 0.9, sensor unknown",
        change=picture_scale(0.9, sensor="own gel"),
        kinds=set(),
        covered=True,
    ),
    Mistake(
        name="displacement and force x 1.1, rest positions as designed",
        change=both(shift(1.1), force(1.1)),
        kinds=set(),
        covered=True,
    ),
    Mistake(name="force x 1.079", change=force(1.079), kinds=set(), among=GAIN, covered=True),
    Mistake(name="force x 0.927", change=force(0.927), kinds=set(), among=GAIN, covered=True),
    Mistake(
        name="one pad's force x 1.079",
        change=force(1.079, only=0),
        kinds=set(),
        among=GAIN,
        covered=True,
    ),
    Mistake(
        name="Poisson's ratio 0.30", change=stated(poisson_ratio=0.30), kinds={CategoryKind.POISSON_RATIO}
    ),
    Mistake(
        name="Poisson's ratio 0.39", change=stated(poisson_ratio=0.39), kinds={CategoryKind.POISSON_RATIO}
    ),
    Mistake(name="a plum's category", change=stated(category="plum"), kinds={CategoryKind.SIZE}),
    Mistake(name="an apricot's category", change=stated(category="apricot"), kinds={CategoryKind.SIZE}),
    Mistake(name="a cherry's category", change=stated(category="cherry"), kinds={CategoryKind.SIZE}),
    Mistake(
        name="poses in metres", change=pose(scaled_place(1e-3)), kinds={FindingKind.POSES_UNIT}, unit="metres"
    ),
    Mistake(
        name="rotations transposed",
        change=pose(transposed),
        kinds={FindingKind.POSES_TRANSPOSED},
        among={FindingKind.POSES_TURNED},
    ),
    Mistake(name="poses of one instant", change=pose(standing_still), kinds={FindingKind.POSES_STILL}),
    Mistake(name="poses of another day", change=other_poses, kinds=set(), among=OF_OTHER_POSES),
    Mistake(
        name="pads' signals exchanged",
        change=exchanged("signals"),
        kinds={FindingKind.PADS_EXCHANGED},
        among=ASIDE,
        harmless=True,
    ),
    Mistake(
        name="pads' poses exchanged",
        change=exchanged("poses"),
        kinds={FindingKind.PADS_EXCHANGED},
        among={FindingKind.POSES_BACK_TO_BACK, FindingKind.ASIDE, FindingKind.PRINT_ASIDE},
    ),
    Mistake(name="another fruit's recording", change=other_recording, kinds=set(), among=OF_ANOTHER_FRUIT),
    Mistake(name="another fruit's mesh", change=other_mesh, kinds=set(), among=OF_ANOTHER_FRUIT),
    Mistake(
        name="mesh turned by 90 degrees",
        change=mesh(middled(lambda v: v @ TURN_90)),
        kinds={FindingKind.MESH_TURNED},
        among=OF_A_TURNED_MESH,
    ),
    Mistake(
        name="mesh lying on its side",
        change=mesh(middled(lambda v: v @ TILT_90)),
        kinds={FindingKind.MESH_TURNED},
        among=OF_A_TURNED_MESH,
    ),
    Mistake(
        name="mesh mirrored",
        change=mesh(middled(lambda v: v @ MIRROR), turn_faces=True),
        kinds=set(),
        among=ASIDE,
        harmless=True,
    ),
    Mistake(
        name="mesh x 1.1", change=mesh(middled(lambda v: 1.1 * v)), kinds=set(), among={FindingKind.WIDTH}
    ),
    Mistake(
        name="mesh x 0.95", change=mesh(middled(lambda v: 0.95 * v)), kinds=set(), among={FindingKind.WIDTH}
    ),
    Mistake(
        name="pit moved 10 mm", change=pit(lambda v: v + np.array([7.0, 0.0, -7.0])), kinds={PitKind.AWAY}
    ),
    Mistake(name="pit moved 6 mm", change=pit(lambda v: v + np.array([6.0, 0.0, 0.0])), kinds={PitKind.AWAY}),
    Mistake(name="pit x 1.4", change=pit(middled(lambda v: 1.4 * v)), kinds={PitKind.SIZE}),
    Mistake(name="pit x 0.6", change=pit(middled(lambda v: 0.6 * v)), kinds={PitKind.SIZE}),
    Mistake(
        name="pit turned by 90 degrees", change=pit(middled(lambda v: v @ TURN_90)), kinds={PitKind.TURNED}
    ),
)

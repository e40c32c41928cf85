"""The mistakes of the field that field_mistakes.py makes, and which findings name each."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import Literal

import field_changes as made
import numpy as np

from pipeline.fruit.input_doubts import CategoryKind, PitKind
from tactile.checks.finding import Field, FindingKind

Said = FindingKind | PitKind | CategoryKind


@dataclass(frozen=True)
class Mistake:
    """A change, and what names it.

    `kinds`: findings whose cause this is, if they are of its `field` and its `unit`; `among`: findings whose
    sentence lists this cause among others. `harmless`: E does not depend on it. `covered`: no check needs to
    name it, and E is within two of its standard deviations.
    """

    name: str
    change: made.Change
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
    Mistake("force in grams", made.force(101.97), A_UNIT_OF_FORCE, among=GAIN, unit="grams"),
    Mistake("force in kN", made.force(1e-3), A_UNIT_OF_FORCE, among=GAIN, unit="kilonewtons"),
    Mistake("force in mN", made.force(1e3), A_UNIT_OF_FORCE, among=GAIN, unit="millinewtons"),
    Mistake("force in pounds", made.force(0.22481), A_UNIT_OF_FORCE, among=GAIN, unit="pounds"),
    Mistake("force x 1.3", made.force(1.3), {FindingKind.FORCE_SCALE}, among=GAIN),
    Mistake("force sign", made.force(-1.0), {FindingKind.SIGN}, field="force"),
    Mistake(
        "one pad's force in grams", made.force(101.97, only=0), A_UNIT_OF_FORCE, among=GAIN, unit="grams"
    ),
    Mistake("one pad's force x 0.5", made.force(0.5, only=1), {FindingKind.FORCE_SCALE}, among=GAIN),
    Mistake(
        "force x and z exchanged",
        made.arrays(lambda p, r: lambda v: made.in_order(v, (2, 1, 0)), made.FORCE),
        {FindingKind.AXES},
        field="force",
    ),
    Mistake("force 5 frames late", made.late("force", 5), {FindingKind.DELAY}),
    Mistake("force 2 frames early", made.late("force", -2), {FindingKind.DELAY}),
    Mistake("force clipped at half", made.clipped("force", 0.5), CLIPPING, field="force"),
    Mistake("force clipped at 80 %", made.clipped("force", 0.8), CLIPPING, field="force"),
    Mistake("force offset, no tare", made.offset(0.3), {FindingKind.NO_TARE}, harmless=True),
    Mistake("force in 6 steps", made.rounded(6), {FindingKind.COARSE_STEPS}, field="force"),
    Mistake(
        "displacement in metres",
        made.shift(1e-3),
        {FindingKind.DISPLACEMENT_UNIT},
        among=GAIN | {FindingKind.TOO_DEEP},
        unit="metres",
    ),
    Mistake(
        "displacement in micrometres",
        made.shift(1e3),
        {FindingKind.DISPLACEMENT_UNIT},
        among=GAIN | {FindingKind.TOO_DEEP},
        unit="micrometres",
    ),
    Mistake("displacement sign", made.shift(-1.0), {FindingKind.SIGN}, field="displacement"),
    Mistake(
        "displacement x 0.5",
        made.shift(0.5),
        {FindingKind.DISPLACEMENT_SCALE},
        among=GAIN | {FindingKind.TOO_DEEP},
    ),
    Mistake(
        "displacement x and z exchanged",
        made.arrays(lambda p, r: lambda v: made.in_order(v, (2, 1, 0)), made.DISPLACEMENT),
        {FindingKind.AXES},
        field="displacement",
    ),
    Mistake(
        "displacement as increments",
        made.arrays(lambda p, r: lambda v: np.diff(v, axis=0, prepend=v[:1]), made.DISPLACEMENT),
        {FindingKind.INCREMENTS},
    ),
    Mistake(
        "one pad's displacement dead",
        made.shift(0.0, only=0),
        {FindingKind.DEAD_FIELD, FindingKind.DEAD_MARKERS},
        field="displacement",
    ),
    Mistake(
        "displacement clipped at half", made.clipped("displacement", 0.5), CLIPPING, field="displacement"
    ),
    Mistake("displacement's markers permuted", made.permuted("displacement"), {FindingKind.OTHER_MARKERS}),
    Mistake("force's markers permuted", made.permuted("force"), {FindingKind.OTHER_MARKERS}),
    Mistake("rest places permuted", made.permuted("rest"), {FindingKind.MARKERS_ORDER}),
    Mistake(
        "rest places in metres",
        made.pads(lambda p, r: replace(p, rest_mm=p.rest_mm * 1e-3)),
        {FindingKind.MARKERS_UNIT},
        unit="metres",
    ),
    Mistake(
        "30 % of markers missing",
        made.without_markers(lambda p, r: made.some(len(p.rest_mm), 0.3, r)),
        MISSING,
        among=OVER_EDGE,
    ),
    Mistake("a hole in the markers", made.without_markers(made.hole), MISSING, among=OVER_EDGE),
    Mistake(
        "half of the markers missing",
        made.without_markers(lambda p, r: p.rest_mm[:, 0] > 0.2),
        MISSING,
        among=OVER_EDGE,
    ),
    Mistake("30 % zero throughout", made.dead(0.3, "zero"), DEAD),
    Mistake("30 % zero from the middle", made.dead(0.3, "zero-late"), DEAD),
    Mistake("30 % frozen from the middle", made.dead(0.3, "frozen"), DEAD),
    Mistake("10 % frozen in force", made.dead(0.1, "frozen", "force"), DEAD),
    Mistake("noise x 10", made.noisy(10.0), {FindingKind.NOISE}, harmless=True),
    Mistake("one frame of zeros", made.zero_frames(1), {FindingKind.ZERO_FRAMES}),
    Mistake("three frames of zeros", made.zero_frames(3), {FindingKind.ZERO_FRAMES}),
    Mistake(
        "gel frames shuffled",
        made.frames(lambda n, r: r.permutation(n), log=False),
        {FindingKind.GEL_FRAMES_SHUFFLED},
        among={FindingKind.OUT_OF_STEP},
    ),
    Mistake(
        "all frames shuffled",
        made.frames(lambda n, r: r.permutation(n), log=True),
        {FindingKind.FRAMES_SHUFFLED},
    ),
    Mistake(
        "every second frame a copy",
        made.frames(lambda n, r: np.arange(n) // 2 * 2, log=False),
        {FindingKind.COPIED_FRAMES},
        harmless=True,
    ),
    Mistake(
        "every third frame dropped",
        made.cut(lambda recording: np.flatnonzero(np.arange(len(recording.time_s)) % 3 != 2)),
        {FindingKind.FRAMES_DROPPED},
        harmless=True,
    ),
    Mistake("no first touch", made.cut(made.from_contact), {FindingKind.STARTS_IN_CONTACT}),
    Mistake("no unloading", made.cut(made.until_peak), {FindingKind.ENDS_PRESSED}, harmless=True),
    Mistake("gel 5 frames late on jaws", made.late("both", 5), {FindingKind.CLOCKS_APART}),
    Mistake(
        "time in ms",
        made.each(lambda o, r: replace(o, time_s=o.time_s * 1e3)),
        {FindingKind.TIME_UNIT},
        harmless=True,
    ),
    Mistake(
        "aperture in cm",
        made.each(lambda o, r: replace(o, aperture_mm=o.aperture_mm / 10)),
        {FindingKind.APERTURE_UNIT},
        unit="centimetres",
        harmless=True,
    ),
    Mistake(
        "stiffness in kPa/mm",
        made.gel(1e3),
        A_UNIT_OF_STIFFNESS,
        unit="kPa/mm (or MPa/m)",
        among=GAIN,
        harmless=True,
    ),
    Mistake("stiffness of another gel", made.gel(2.2), NOT_OF_SENSOR, among=GAIN, harmless=True),
    Mistake("stiffness and force x 2", made.both(made.gel(2.0), made.force(2.0)), NOT_OF_SENSOR),
    Mistake("stiffness and force x 0.5", made.both(made.gel(0.5), made.force(0.5)), NOT_OF_SENSOR),
    Mistake("picture scale 1.1", made.picture_scale(1.1), {FindingKind.PITCH_NOT_OF_SENSOR}),
    Mistake("picture scale 0.9", made.picture_scale(0.9), {FindingKind.PITCH_NOT_OF_SENSOR}),
    Mistake(
        "picture scale 1.1, sensor unknown", made.picture_scale(1.1, sensor="own gel"), set(), covered=True
    ),
    Mistake(
        "picture scale 0.9, sensor unknown", made.picture_scale(0.9, sensor="own gel"), set(), covered=True
    ),
    Mistake(
        "displacement and force x 1.1, rest positions as designed",
        made.both(made.shift(1.1), made.force(1.1)),
        set(),
        covered=True,
    ),
    Mistake("force x 1.079", made.force(1.079), set(), among=GAIN, covered=True),
    Mistake("force x 0.927", made.force(0.927), set(), among=GAIN, covered=True),
    Mistake("one pad's force x 1.079", made.force(1.079, only=0), set(), among=GAIN, covered=True),
    Mistake("Poisson's ratio 0.30", made.stated(poisson_ratio=0.3), {CategoryKind.POISSON_RATIO}),
    Mistake("Poisson's ratio 0.39", made.stated(poisson_ratio=0.39), {CategoryKind.POISSON_RATIO}),
    Mistake("a plum's category", made.stated(category="plum"), {CategoryKind.SIZE}),
    Mistake("an apricot's category", made.stated(category="apricot"), {CategoryKind.SIZE}),
    Mistake("a cherry's category", made.stated(category="cherry"), {CategoryKind.SIZE}),
    Mistake("poses in metres", made.pose(made.scaled_place(1e-3)), {FindingKind.POSES_UNIT}, unit="metres"),
    Mistake(
        "rotations transposed",
        made.pose(made.transposed),
        {FindingKind.POSES_TRANSPOSED},
        among={FindingKind.POSES_TURNED},
    ),
    Mistake("poses of one instant", made.pose(made.standing_still), {FindingKind.POSES_STILL}),
    Mistake("poses of another day", made.other_poses, set(), among=OF_OTHER_POSES),
    Mistake(
        "pads' signals exchanged",
        made.exchanged("signals"),
        {FindingKind.PADS_EXCHANGED},
        among=ASIDE,
        harmless=True,
    ),
    Mistake(
        "pads' poses exchanged",
        made.exchanged("poses"),
        {FindingKind.PADS_EXCHANGED},
        among={FindingKind.POSES_BACK_TO_BACK, FindingKind.ASIDE, FindingKind.PRINT_ASIDE},
    ),
    Mistake("another fruit's recording", made.other_recording, set(), among=OF_ANOTHER_FRUIT),
    Mistake("another fruit's mesh", made.other_mesh, set(), among=OF_ANOTHER_FRUIT),
    Mistake(
        "mesh turned by 90 degrees",
        made.mesh(made.about_the_middle(lambda v: v @ TURN_90)),
        {FindingKind.MESH_TURNED},
        among=OF_A_TURNED_MESH,
    ),
    Mistake(
        "mesh lying on its side",
        made.mesh(made.about_the_middle(lambda v: v @ TILT_90)),
        {FindingKind.MESH_TURNED},
        among=OF_A_TURNED_MESH,
    ),
    Mistake(
        "mesh mirrored",
        made.mesh(made.about_the_middle(lambda v: v @ MIRROR), turn_faces=True),
        set(),
        among=ASIDE,
        harmless=True,
    ),
    Mistake(
        "mesh x 1.1", made.mesh(made.about_the_middle(lambda v: 1.1 * v)), set(), among={FindingKind.WIDTH}
    ),
    Mistake(
        "mesh x 0.95", made.mesh(made.about_the_middle(lambda v: 0.95 * v)), set(), among={FindingKind.WIDTH}
    ),
    Mistake("pit moved 10 mm", made.pit(lambda v: v + np.array([7.0, 0.0, -7.0])), {PitKind.AWAY}),
    Mistake("pit moved 6 mm", made.pit(lambda v: v + np.array([6.0, 0.0, 0.0])), {PitKind.AWAY}),
    Mistake("pit x 1.4", made.pit(made.about_the_middle(lambda v: 1.4 * v)), {PitKind.SIZE}),
    Mistake("pit x 0.6", made.pit(made.about_the_middle(lambda v: 0.6 * v)), {PitKind.SIZE}),
    Mistake(
        "pit turned by 90 degrees", made.pit(made.about_the_middle(lambda v: v @ TURN_90)), {PitKind.TURNED}
    ),
)

"""The mistakes of the field that field_mistakes.py makes, and which findings name each."""

from collections.abc import Set as AbstractSet
from dataclasses import KW_ONLY, dataclass, replace
from typing import Literal

import field_changes as changes
import numpy as np

from pipeline.fruit.input_doubts import CategoryKind, PitKind
from tactile.consistency.finding import Field, FindingKind

Said = FindingKind | PitKind | CategoryKind


@dataclass(frozen=True)
class Mistake:
    """A change, and what names it.

    `kinds`: findings whose cause this is, if they are of its `field` and its `unit`; `among`: findings whose
    sentence lists this cause among others. `harmless`: E does not depend on it. `covered`: no check needs to
    name it, and E is within two of its standard deviations.
    """

    name: str
    change: changes.Change
    kinds: AbstractSet[Said]
    _: KW_ONLY
    among: AbstractSet[Said] = frozenset()
    field: Field | None = None
    unit: str = ""
    harmless: bool = False
    covered: bool = False


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One thing that is said of a fruit; `detail` as in tactile.consistency.finding (of a unit: the unit)."""

    kind: Said
    sentence: str
    field: Field | None = None
    detail: str = ""
    also: frozenset[FindingKind] = frozenset()
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
        return "among several" if {first.kind, *first.also} & {*mistake.among, *mistake.kinds} else ""
    of_unit = bool(mistake.unit) or first.kind is FindingKind.SCALE
    said = [
        ({first.field} - {None}, mistake.field),
        ((set(first.detail.split(" or ")) - {""}) if of_unit else set(), mistake.unit),
    ]
    if any(of and wanted not in {*of, None} for of, wanted in said):
        return ""
    clear = not first.also and all(not wanted or of == {wanted} for of, wanted in said)
    return "named" if clear else "among several"


TURN_90 = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
TILT_90 = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRROR = np.diag([-1.0, 1, 1])

SCALE, OVER_EDGE = {FindingKind.SCALE}, {FindingKind.OVER_EDGE}
MISSING, DEAD = {FindingKind.MARKERS_MISSING}, {FindingKind.DEAD_MARKERS}
ORDER = {FindingKind.OTHER_MARKERS, FindingKind.MARKERS_ORDER}
NOT_OF_SENSOR = {FindingKind.STIFFNESS_NOT_OF_SENSOR}
CLIPPING = {FindingKind.CLIPPED}
PLACES = {FindingKind.WIDTH, FindingKind.ASIDE, FindingKind.PRINT_ASIDE}
OF_A_MESH = PLACES | {FindingKind.PADS_EXCHANGED, FindingKind.MESH_TURNED}
OF_OTHER_POSES = OF_A_MESH | {
    FindingKind.POSES_STILL,
    FindingKind.POSES_TURNED,
    FindingKind.APERTURE,
    FindingKind.TOO_DEEP,
}
MISTAKES: tuple[Mistake, ...] = (
    Mistake("force in grams", changes.force(101.97), SCALE, field="force", unit="grams"),
    Mistake("force in kN", changes.force(1e-3), SCALE, field="force", unit="kilonewtons"),
    Mistake("force in mN", changes.force(1e3), SCALE, field="force", unit="millinewtons"),
    Mistake("force in pounds", changes.force(0.22481), SCALE, field="force", unit="pounds"),
    Mistake("force x 1.3", changes.force(1.3), SCALE, field="force"),
    Mistake("force sign", changes.force(-1.0), {FindingKind.SIGN}, field="force"),
    Mistake("one pad's force in grams", changes.force(101.97, only=0), SCALE, field="force", unit="grams"),
    Mistake("one pad's force x 0.5", changes.force(0.5, only=1), SCALE, field="force"),
    Mistake(
        "force x and z exchanged",
        changes.arrays(lambda p, r: lambda v: changes.in_order(v, (2, 1, 0)), changes.FORCE),
        {FindingKind.AXES},
        field="force",
    ),
    Mistake("force 5 frames late", changes.late("force", 5), {FindingKind.DELAY}),
    Mistake("force 2 frames early", changes.late("force", -2), {FindingKind.DELAY}),
    Mistake("force clipped at half", changes.clipped("force", 0.5), CLIPPING, field="force"),
    Mistake("force clipped at 80 %", changes.clipped("force", 0.8), CLIPPING, field="force"),
    Mistake("force offset, no tare", changes.offset(0.3), {FindingKind.NO_TARE}, harmless=True),
    Mistake("force in 6 steps", changes.rounded(6), set(), harmless=True),
    Mistake(
        "displacement in metres",
        changes.shift(1e-3),
        SCALE,
        field="displacement",
        among={FindingKind.TOO_DEEP},
        unit="metres",
    ),
    Mistake(
        "displacement in micrometres",
        changes.shift(1e3),
        SCALE,
        field="displacement",
        among={FindingKind.TOO_DEEP},
        unit="micrometres",
    ),
    Mistake("displacement sign", changes.shift(-1.0), {FindingKind.SIGN}, field="displacement"),
    Mistake(
        "displacement x 0.5", changes.shift(0.5), SCALE, field="displacement", among={FindingKind.TOO_DEEP}
    ),
    Mistake(
        "displacement x and z exchanged",
        changes.arrays(lambda p, r: lambda v: changes.in_order(v, (2, 1, 0)), changes.DISPLACEMENT),
        {FindingKind.AXES},
        field="displacement",
    ),
    Mistake(
        "displacement as increments",
        changes.arrays(lambda p, r: lambda v: np.diff(v, axis=0, prepend=v[:1]), changes.DISPLACEMENT),
        {FindingKind.INCREMENTS},
    ),
    Mistake(
        "one pad's displacement dead",
        changes.shift(0.0, only=0),
        {FindingKind.DEAD_FIELD, FindingKind.DEAD_MARKERS},
        field="displacement",
    ),
    Mistake(
        "displacement clipped at half", changes.clipped("displacement", 0.5), CLIPPING, field="displacement"
    ),
    Mistake("displacement's markers permuted", changes.permuted("displacement"), ORDER),
    Mistake("force's markers permuted", changes.permuted("force"), ORDER),
    Mistake("rest places permuted", changes.permuted("rest"), ORDER),
    Mistake(
        "rest places in metres",
        changes.pads(lambda p, r: replace(p, rest_mm=p.rest_mm * 1e-3)),
        {FindingKind.MARKERS_UNIT},
        unit="metres",
    ),
    Mistake(
        "30 % of markers missing",
        changes.without_markers(lambda p, r: changes.some(len(p.rest_mm), 0.3, r)),
        MISSING,
        among=OVER_EDGE,
    ),
    Mistake("a hole in the markers", changes.without_markers(changes.hole), MISSING, among=OVER_EDGE),
    Mistake(
        "half of the markers missing",
        changes.without_markers(lambda p, r: p.rest_mm[:, 0] > 0.2),
        MISSING,
        among=OVER_EDGE,
    ),
    Mistake("30 % zero throughout", changes.dead(0.3, "zero"), DEAD),
    Mistake("30 % zero from the middle", changes.dead(0.3, "zero-late"), DEAD),
    Mistake("30 % frozen from the middle", changes.dead(0.3, "frozen"), DEAD),
    Mistake("10 % frozen in force", changes.dead(0.1, "frozen", "force"), DEAD),
    Mistake("noise x 10", changes.noisy(10.0), {FindingKind.NOISE}, harmless=True),
    Mistake("one frame of zeros", changes.zero_frames(1), {FindingKind.ZERO_FRAMES}),
    Mistake("three frames of zeros", changes.zero_frames(3), {FindingKind.ZERO_FRAMES}),
    Mistake(
        "gel frames shuffled",
        changes.frames(lambda n, r: r.permutation(n), log=False),
        {FindingKind.GEL_FRAMES_SHUFFLED},
        among={FindingKind.OUT_OF_STEP},
    ),
    Mistake(
        "all frames shuffled",
        changes.frames(lambda n, r: r.permutation(n), log=True),
        {FindingKind.FRAMES_SHUFFLED},
    ),
    Mistake(
        "every second frame a copy",
        changes.frames(lambda n, r: np.arange(n) // 2 * 2, log=False),
        {FindingKind.COPIED_FRAMES},
        harmless=True,
    ),
    Mistake(
        "every third frame dropped",
        changes.cut(lambda recording: np.flatnonzero(np.arange(len(recording.time_s)) % 3 != 2)),
        set(),
        harmless=True,
    ),
    Mistake("no first touch", changes.cut(changes.from_contact), {FindingKind.STARTS_IN_CONTACT}),
    Mistake("no unloading", changes.cut(changes.until_peak), {FindingKind.ENDS_PRESSED}, harmless=True),
    Mistake("gel 5 frames late on jaws", changes.late("both", 5), {FindingKind.CLOCKS_APART}),
    Mistake(
        "time in ms",
        changes.each(lambda o, r: replace(o, time_s=o.time_s * 1e3)),
        {FindingKind.TIME_UNIT},
        harmless=True,
    ),
    Mistake(
        "aperture in cm",
        changes.each(lambda o, r: replace(o, aperture_mm=o.aperture_mm / 10)),
        {FindingKind.APERTURE_UNIT},
        unit="centimetres",
        harmless=True,
    ),
    Mistake(
        "stiffness in kPa/mm",
        changes.gel(1e3),
        SCALE,
        field="stiffness",
        unit="kPa/mm (or MPa/m)",
        harmless=True,
    ),
    Mistake("stiffness of another gel", changes.gel(2.2), SCALE, field="stiffness", harmless=True),
    Mistake("stiffness and force x 2", changes.both(changes.gel(2.0), changes.force(2.0)), NOT_OF_SENSOR),
    Mistake("stiffness and force x 0.5", changes.both(changes.gel(0.5), changes.force(0.5)), NOT_OF_SENSOR),
    Mistake("picture scale 1.1", changes.picture_scale(1.1), {FindingKind.PITCH_NOT_OF_SENSOR}),
    Mistake("picture scale 0.9", changes.picture_scale(0.9), {FindingKind.PITCH_NOT_OF_SENSOR}),
    Mistake(
        "picture scale 1.1, sensor unknown", changes.picture_scale(1.1, sensor="own gel"), set(), covered=True
    ),
    Mistake(
        "picture scale 0.9, sensor unknown", changes.picture_scale(0.9, sensor="own gel"), set(), covered=True
    ),
    Mistake(
        "displacement and force x 1.1, rest positions as designed",
        changes.both(changes.shift(1.1), changes.force(1.1)),
        set(),
        covered=True,
    ),
    Mistake("force x 1.079", changes.force(1.079), set(), among=SCALE, covered=True),
    Mistake("force x 0.927", changes.force(0.927), set(), among=SCALE, covered=True),
    Mistake("one pad's force x 1.079", changes.force(1.079, only=0), set(), among=SCALE, covered=True),
    Mistake("Poisson's ratio 0.30", changes.stated(poisson_ratio=0.30), {CategoryKind.POISSON_RATIO}),
    Mistake("Poisson's ratio 0.39", changes.stated(poisson_ratio=0.39), {CategoryKind.POISSON_RATIO}),
    Mistake("a plum's category", changes.stated(category="plum"), {CategoryKind.SIZE}),
    Mistake("an apricot's category", changes.stated(category="apricot"), {CategoryKind.SIZE}),
    Mistake("a cherry's category", changes.stated(category="cherry"), {CategoryKind.SIZE}),
    Mistake(
        "poses in metres", changes.pose(changes.scaled_place(1e-3)), {FindingKind.POSES_UNIT}, unit="metres"
    ),
    Mistake(
        "rotations transposed",
        changes.pose(changes.transposed),
        {FindingKind.POSES_TRANSPOSED},
        among={FindingKind.POSES_TURNED},
    ),
    Mistake("poses of one instant", changes.pose(changes.standing_still), {FindingKind.POSES_STILL}),
    Mistake("poses of another day", changes.other_poses, set(), among=OF_OTHER_POSES),
    Mistake(
        "pads' signals exchanged",
        changes.exchanged("signals"),
        {FindingKind.PADS_EXCHANGED},
        among=PLACES,
        harmless=True,
    ),
    Mistake(
        "pads' poses exchanged",
        changes.exchanged("poses"),
        {FindingKind.PADS_EXCHANGED},
        among=PLACES | {FindingKind.POSES_BACK_TO_BACK},
    ),
    Mistake("another fruit's recording", changes.other_recording, set(), among=OF_A_MESH),
    Mistake("another fruit's mesh", changes.other_mesh, set(), among=OF_A_MESH),
    Mistake(
        "mesh turned by 90 degrees",
        changes.mesh(changes.about_the_middle(lambda v: v @ TURN_90)),
        {FindingKind.MESH_TURNED},
        among=OF_A_MESH,
    ),
    Mistake(
        "mesh lying on its side",
        changes.mesh(changes.about_the_middle(lambda v: v @ TILT_90)),
        {FindingKind.MESH_TURNED},
        among=OF_A_MESH,
    ),
    Mistake(
        "mesh mirrored",
        changes.mesh(changes.about_the_middle(lambda v: v @ MIRROR), turn_faces=True),
        set(),
        among=PLACES,
        harmless=True,
    ),
    Mistake(
        "mesh x 1.1",
        changes.mesh(changes.about_the_middle(lambda v: 1.1 * v)),
        set(),
        among={FindingKind.WIDTH},
    ),
    Mistake(
        "mesh x 0.95",
        changes.mesh(changes.about_the_middle(lambda v: 0.95 * v)),
        set(),
        among={FindingKind.WIDTH},
    ),
    Mistake("pit moved 10 mm", changes.pit(lambda v: v + np.array([7.0, 0.0, -7.0])), {PitKind.AWAY}),
    Mistake("pit moved 6 mm", changes.pit(lambda v: v + np.array([6.0, 0.0, 0.0])), {PitKind.AWAY}),
    Mistake("pit x 1.4", changes.pit(changes.about_the_middle(lambda v: 1.4 * v)), {PitKind.SIZE}),
    Mistake("pit x 0.6", changes.pit(changes.about_the_middle(lambda v: 0.6 * v)), {PitKind.SIZE}),
    Mistake(
        "pit turned by 90 degrees",
        changes.pit(changes.about_the_middle(lambda v: v @ TURN_90)),
        {PitKind.TURNED},
    ),
)

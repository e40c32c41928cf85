"""The mistakes of the field that field_mistakes.py makes, and which findings name each."""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, Literal

import field_changes as changes
import numpy as np

from pipeline.fruit.input_doubts import CategoryKind, Doubt, PitKind
from tactile.consistency.finding import Field, Finding
from tactile.consistency.finding import FindingKind as Kind
from tactile.readers.recording import GelPad

Said = Kind | PitKind | CategoryKind


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


def naming(first: Finding | Doubt | None, mistake: Mistake) -> Literal["named", "among several", ""]:
    """How what stands first names the mistake.

    A finding of its kind that leaves the field or the unit open lists it among others; one of another field
    or unit does not name it.
    """
    if first is None:
        return ""
    also, detail = (first.also, first.detail) if isinstance(first, Finding) else (frozenset(), "")
    if first.kind not in mistake.kinds:
        return "among several" if {first.kind, *also} & {*mistake.among, *mistake.kinds} else ""
    of_unit = bool(mistake.unit) or first.kind is Kind.SCALE
    said = [
        ({first.field} - {None}, mistake.field),
        ((set(detail.split(" or ")) - {""}) if of_unit else set(), mistake.unit),
    ]
    if any(of and wanted not in {*of, None} for of, wanted in said):
        return ""
    clear = not also and all(not wanted or of == {wanted} for of, wanted in said)
    return "named" if clear else "among several"


def gain(name: str, field: Field, times: float, *, only: int | None = None, **more: Any) -> Mistake:
    """A field times a factor, of every pad or the `only` one: another unit, or another gain."""
    return Mistake(name, changes.scaled(field, times, only=only), SCALE, field=field, **more)


def missing(name: str, choose: Callable[[GelPad, np.random.Generator], np.ndarray]) -> Mistake:
    """Markers that are not there."""
    return Mistake(name, changes.without_markers(choose), {Kind.MARKERS_MISSING}, among={Kind.OVER_EDGE})


TURN_90 = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
TILT_90 = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRROR = np.diag([-1.0, 1, 1])

SCALE, DEEP = {Kind.SCALE}, {Kind.TOO_DEEP}
DEAD = {Kind.DEAD_MARKERS}
ORDER = {Kind.OTHER_MARKERS, Kind.MARKERS_ORDER}
NOT_OF_SENSOR = {Kind.STIFFNESS_NOT_OF_SENSOR}
CLIPPING = {Kind.CLIPPED}
PLACES = {Kind.WIDTH, Kind.ASIDE, Kind.PRINT_ASIDE}
OF_A_MESH = PLACES | {Kind.PADS_EXCHANGED, Kind.MESH_TURNED}
OF_OTHER_POSES = OF_A_MESH | {Kind.POSES_STILL, Kind.POSES_TURNED, Kind.APERTURE, Kind.TOO_DEEP}
MISTAKES: tuple[Mistake, ...] = (
    gain("force in grams", "force", 101.97, unit="grams"),
    gain("force in kN", "force", 1e-3, unit="kilonewtons"),
    gain("force in mN", "force", 1e3, unit="millinewtons"),
    gain("force in pounds", "force", 0.22481, unit="pounds"),
    gain("force x 1.3", "force", 1.3),
    Mistake("force sign", changes.scaled("force", -1.0), {Kind.SIGN}, field="force"),
    gain("one pad's force in grams", "force", 101.97, only=0, unit="grams"),
    gain("one pad's force x 0.5", "force", 0.5, only=1),
    Mistake("force x and z exchanged", changes.axes_exchanged("force"), {Kind.AXES}, field="force"),
    Mistake("force 5 frames late", changes.late("force", 5), {Kind.DELAY}),
    Mistake("force 2 frames early", changes.late("force", -2), {Kind.DELAY}),
    Mistake("force clipped at half", changes.clipped("force", 0.5), CLIPPING, field="force"),
    Mistake("force clipped at 80 %", changes.clipped("force", 0.8), CLIPPING, field="force"),
    Mistake("force offset, no tare", changes.offset(0.3), {Kind.NO_TARE}, harmless=True),
    Mistake("force in 6 steps", changes.rounded(6), set(), harmless=True),
    gain("displacement in metres", "displacement", 1e-3, among=DEEP, unit="metres"),
    gain("displacement in micrometres", "displacement", 1e3, among=DEEP, unit="micrometres"),
    Mistake("displacement sign", changes.scaled("displacement", -1.0), {Kind.SIGN}, field="displacement"),
    gain("displacement x 0.5", "displacement", 0.5, among=DEEP),
    Mistake(
        "displacement x and z exchanged",
        changes.axes_exchanged("displacement"),
        {Kind.AXES},
        field="displacement",
    ),
    Mistake(
        "displacement as increments",
        changes.always("displacement", lambda v: np.diff(v, axis=0, prepend=v[:1])),
        {Kind.INCREMENTS},
    ),
    Mistake(
        "one pad's displacement dead",
        changes.scaled("displacement", 0.0, only=0),
        {Kind.DEAD_FIELD, Kind.DEAD_MARKERS},
        field="displacement",
    ),
    Mistake(
        "displacement clipped at half", changes.clipped("displacement", 0.5), CLIPPING, field="displacement"
    ),
    Mistake("displacement's markers permuted", changes.permuted("displacement"), ORDER),
    Mistake("force's markers permuted", changes.permuted("force"), ORDER),
    Mistake("rest places permuted", changes.permuted("rest"), ORDER),
    Mistake("rest places in metres", changes.scaled("rest", 1e-3), {Kind.MARKERS_UNIT}, unit="metres"),
    missing("30 % of markers missing", lambda p, r: changes.some(len(p.rest_mm), 0.3, r)),
    missing("a hole in the markers", changes.hole),
    missing("half of the markers missing", lambda p, r: p.rest_mm[:, 0] > 0.2),
    Mistake("30 % zero throughout", changes.dead(0.3, "zero"), DEAD),
    Mistake("30 % zero from the middle", changes.dead(0.3, "zero-late"), DEAD),
    Mistake("30 % frozen from the middle", changes.dead(0.3, "frozen"), DEAD),
    Mistake("10 % frozen in force", changes.dead(0.1, "frozen", "force"), DEAD),
    Mistake("noise x 10", changes.noisy(10.0), {Kind.NOISE}, harmless=True),
    Mistake("one frame of zeros", changes.zero_frames(1), {Kind.ZERO_FRAMES}),
    Mistake("three frames of zeros", changes.zero_frames(3), {Kind.ZERO_FRAMES}),
    Mistake(
        "gel frames shuffled",
        changes.frames(lambda n, r: r.permutation(n), log=False),
        {Kind.GEL_FRAMES_SHUFFLED},
        among={Kind.OUT_OF_STEP},
    ),
    Mistake(
        "all frames shuffled", changes.frames(lambda n, r: r.permutation(n), log=True), {Kind.FRAMES_SHUFFLED}
    ),
    Mistake(
        "every second frame a copy",
        changes.frames(lambda n, r: np.arange(n) // 2 * 2, log=False),
        {Kind.COPIED_FRAMES},
        harmless=True,
    ),
    Mistake(
        "every third frame dropped",
        changes.cut(lambda recording: np.flatnonzero(np.arange(len(recording.time_s)) % 3 != 2)),
        set(),
        harmless=True,
    ),
    Mistake("no first touch", changes.cut(changes.from_contact), {Kind.STARTS_IN_CONTACT}),
    Mistake("no unloading", changes.cut(changes.until_peak), {Kind.ENDS_PRESSED}, harmless=True),
    Mistake("gel 5 frames late on jaws", changes.late("both", 5), {Kind.CLOCKS_APART}),
    Mistake(
        "time in ms",
        changes.each(lambda o, r: replace(o, time_s=o.time_s * 1e3)),
        {Kind.TIME_UNIT},
        harmless=True,
    ),
    Mistake(
        "aperture in cm",
        changes.each(lambda o, r: replace(o, aperture_mm=o.aperture_mm / 10)),
        {Kind.APERTURE_UNIT},
        unit="centimetres",
        harmless=True,
    ),
    gain("stiffness in kPa/mm", "stiffness", 1e3, unit="kPa/mm (or MPa/m)", harmless=True),
    gain("stiffness of another gel", "stiffness", 2.2, harmless=True),
    Mistake("stiffness and force x 2", changes.scaled("stiffness and force", 2.0), NOT_OF_SENSOR),
    Mistake("stiffness and force x 0.5", changes.scaled("stiffness and force", 0.5), NOT_OF_SENSOR),
    Mistake("picture scale 1.1", changes.picture_scale(1.1), {Kind.PITCH_NOT_OF_SENSOR}),
    Mistake("picture scale 0.9", changes.picture_scale(0.9), {Kind.PITCH_NOT_OF_SENSOR}),
    Mistake(
        "picture scale 1.1, sensor unknown", changes.picture_scale(1.1, sensor="own gel"), set(), covered=True
    ),
    Mistake(
        "picture scale 0.9, sensor unknown", changes.picture_scale(0.9, sensor="own gel"), set(), covered=True
    ),
    Mistake(
        "displacement and force x 1.1, rest positions as designed",
        changes.scaled("both", 1.1),
        set(),
        covered=True,
    ),
    Mistake("force x 1.079", changes.scaled("force", 1.079), set(), among=SCALE, covered=True),
    Mistake("force x 0.927", changes.scaled("force", 0.927), set(), among=SCALE, covered=True),
    Mistake(
        "one pad's force x 1.079", changes.scaled("force", 1.079, only=0), set(), among=SCALE, covered=True
    ),
    Mistake("Poisson's ratio 0.30", changes.stated(poisson_ratio=0.30), {CategoryKind.POISSON_RATIO}),
    Mistake("Poisson's ratio 0.39", changes.stated(poisson_ratio=0.39), {CategoryKind.POISSON_RATIO}),
    Mistake("a plum's category", changes.stated(category="plum"), {CategoryKind.SIZE}),
    Mistake("an apricot's category", changes.stated(category="apricot"), {CategoryKind.SIZE}),
    Mistake("a cherry's category", changes.stated(category="cherry"), {CategoryKind.SIZE}),
    Mistake("poses in metres", changes.always("pose", changes.in_metres), {Kind.POSES_UNIT}, unit="metres"),
    Mistake(
        "rotations transposed",
        changes.always("pose", changes.transposed),
        {Kind.POSES_TRANSPOSED},
        among={Kind.POSES_TURNED},
    ),
    Mistake("poses of one instant", changes.always("pose", changes.standing_still), {Kind.POSES_STILL}),
    Mistake("poses of another day", changes.other_poses, set(), among=OF_OTHER_POSES),
    Mistake(
        "pads' signals exchanged",
        changes.exchanged("markers"),
        {Kind.PADS_EXCHANGED},
        among=PLACES,
        harmless=True,
    ),
    Mistake(
        "pads' poses exchanged",
        changes.exchanged("pose"),
        {Kind.PADS_EXCHANGED},
        among=PLACES | {Kind.POSES_BACK_TO_BACK},
    ),
    Mistake("another fruit's recording", changes.other_recording, set(), among=OF_A_MESH),
    Mistake("another fruit's mesh", changes.other_mesh, set(), among=OF_A_MESH),
    Mistake(
        "mesh turned by 90 degrees", changes.mesh(lambda v: v @ TURN_90), {Kind.MESH_TURNED}, among=OF_A_MESH
    ),
    Mistake(
        "mesh lying on its side", changes.mesh(lambda v: v @ TILT_90), {Kind.MESH_TURNED}, among=OF_A_MESH
    ),
    Mistake(
        "mesh mirrored",
        changes.mesh(lambda v: v @ MIRROR, turn_faces=True),
        set(),
        among=PLACES,
        harmless=True,
    ),
    Mistake("mesh x 1.1", changes.mesh(lambda v: 1.1 * v), set(), among={Kind.WIDTH}),
    Mistake("mesh x 0.95", changes.mesh(lambda v: 0.95 * v), set(), among={Kind.WIDTH}),
    Mistake("pit moved 10 mm", changes.pit(lambda v: v + np.array([7.0, 0.0, -7.0])), {PitKind.AWAY}),
    Mistake("pit moved 6 mm", changes.pit(lambda v: v + np.array([6.0, 0.0, 0.0])), {PitKind.AWAY}),
    Mistake("pit x 1.4", changes.pit(lambda v: 1.4 * v), {PitKind.SIZE}),
    Mistake("pit x 0.6", changes.pit(lambda v: 0.6 * v), {PitKind.SIZE}),
    Mistake("pit turned by 90 degrees", changes.pit(lambda v: v @ TURN_90), {PitKind.TURNED}),
)

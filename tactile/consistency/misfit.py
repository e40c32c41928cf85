"""The likelihood of a recording: a product over relations that every valid recording obeys.

Each relation is a quantity whose spread over valid recordings is known. With r its distance in standard
deviations, its log likelihood is that of Student's t with 9 degrees of freedom, -5 ln(1 + r^2 / 9). The heavy
tails allow for fruit and sensors that no recording shows yet (Lange, Little and Taylor 1989). The standard
deviations in relations.py and footprint.py come from benchmarks/field_spreads.py unless
marked as assumed.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from tactile.consistency.finding import MEANINGLESS, Field
from tactile.consistency.finding import FindingKind as Kind
from tactile.consistency.pressing import Pressing, pressing_of
from tactile.readers.recording import GelPad, Recording
from tactile.readers.sensor_model import PublishedGel

SIGNALS = ("rest_mm", "displacement_mm", "force_N", "gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm")
"""Fields of a pad on which its prepared signals depend."""
LIMIT = 5.0
"""Log Bayes factor above which a transformation is named, and loss above which a relation fails. It means
odds of 150, as many as there are relations and transformations, or 3.9 standard deviations."""
FAILS_AT = 3.0 * float(np.sqrt(np.expm1(LIMIT / 5.0)))
"""The same limit in standard deviations."""
OVER_NOISE = 10.0
"""Means and sums below this many standard deviations of their noise are not judged."""


WRONG_MESH = (
    "the mesh is rotated, mirrored or of another fruit, or a pose is wrong (a moved pad, another day, the "
    "other pad)"
)
CAUSES = {
    Kind.SCALE: "a gain of the force, a scale of the displacement, a creeping gel, or the stiffness (kn, kt) "
    "of another gel",
    Kind.OUT_OF_STEP: "frames of one of them are shuffled, missing or wrong; record the grasp again",
    Kind.OTHER_MARKERS: "one of them has another marker order (permuted), or other axes; write both in one "
    "order",
    Kind.AXES: "its axes are exchanged or rotated; z points out of the gel into the fruit",
    Kind.MARKERS_UNIT: "another unit; write the positions of the markers on the gel in millimetres",
    Kind.MARKERS_ORDER: "markers are in another order (permuted) in rest_mm than in displacement and force; "
    "write all three in one order",
    Kind.STIFFNESS_NOT_OF_SENSOR: "a wrong value, or another gel. E has the same relative error if the "
    "forces use this value. Correct the stiffness, or state the gel's own under [sensor] in batch.toml",
    Kind.PITCH_NOT_OF_SENSOR: "the scale of the gel's pictures is wrong (in displacement and forces), or the "
    "sensor has another gel. Calibrate the sensor's camera",
    Kind.TOO_DEEP: "displacement or poses are scaled, or from another recording",
    Kind.FRAMES_SHUFFLED: "the frames are out of order (shuffled); sort the frames by their times",
    Kind.GEL_FRAMES_SHUFFLED: "its frames are out of order (shuffled) relative to the jaws' log",
    Kind.CLOCKS_APART: "the two clocks disagree (lag); give gel and jaws one clock",
    Kind.POSES_TURNED: "rotations are transposed, or the poses are from another day; record the poses again",
    Kind.POSE_AWAY: "a wrong pose; z must point out of the gel into the fruit",
    Kind.APERTURE: "aperture and poses disagree (from another recording, or with another clock)",
    Kind.POSES_UNIT: "poses or mesh have another unit; write millimetres",
    Kind.WIDTH: "the recording is of another fruit, the mesh is scaled, rotated or of another fruit, or the "
    "poses are wrong",
    Kind.ASIDE: WRONG_MESH,
    Kind.PRINT_ASIDE: WRONG_MESH,
}
"""Likely cause, and advice, for a relation that fails and that no transformation explains."""
COMPARED = frozenset({Kind.UNBALANCED, Kind.MODULUS})
"""Relations that fruit and pads may break too: they serve only to compare transformations."""


@dataclass(frozen=True)
class Misfit:
    """Distance of a recording from one relation.

    `sds`: in standard deviations of valid recordings. `says` continues the pads' names: what was found, and
    what was expected. `relative_sd`: of E, if no transformation explains the misfit.
    """

    kind: Kind
    sds: float
    says: str = ""
    _: KW_ONLY
    pads: tuple[str, ...] = ()
    field: Field | None = None
    detail: str = ""
    relative_sd: float = MEANINGLESS

    @property
    def loss(self) -> float:
        """Minus the log likelihood, 0 at its maximum."""
        return float(5.0 * np.log1p(self.sds**2 / 9.0))

    @property
    def fails(self) -> bool:
        """Whether this relation alone makes the recording invalid."""
        return self.loss > LIMIT and self.kind not in COMPARED


@dataclass(frozen=True, kw_only=True)
class Situation:
    """A recording with its prepared pads, and its references: mesh of the fruit and the mesh's error, moduli
    of the category, gels of the sensor. `touch_is_seen`: nothing hides where pads meet the fruit.
    """

    recording: Recording
    pressings: tuple[Pressing, ...]
    vertices: Float[np.ndarray, "v 3"] | None = None
    faces: Int[np.ndarray, "f 3"] | None = None
    E_range_MPa: tuple[float, float] | None = None
    surface_sd_mm: float = 0.0
    gels: tuple[PublishedGel, ...] = ()
    touch_is_seen: bool = True

    def with_pads(self, pads: Sequence[GelPad]) -> "Situation":
        """The same with these pads; pads whose signals did not change are not prepared again."""
        ready = tuple(
            replace(press, pad=pad)
            if all(getattr(press.pad, name) is getattr(pad, name) for name in SIGNALS)
            else pressing_of(pad)
            for press, pad in zip(self.pressings, pads, strict=True)
        )
        return replace(self, recording=replace(self.recording, pads=tuple(pads)), pressings=ready)


def abs_ln(ratio: float) -> float:
    """|ln| of a ratio, large where it is 0."""
    return abs(float(np.log(max(ratio, 1e-12))))


def degrees(cosine: float) -> float:
    """The angle with this cosine, clipped to -1 to 1."""
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))

"""One thing that cannot be right in a recording: its cause as a sentence, and what it does to E."""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from enum import IntEnum, StrEnum
from typing import Literal

import numpy as np

Field = Literal["displacement", "force"]
SIMILAR_FACTOR = 0.12
"""Natural logarithm within which a factor counts as a unit's: gains of sound recordings spread by 0.05."""
FORCE = {
    101.97: "grams",
    0.10197: "kilograms",
    1e3: "millinewtons",
    1e-3: "kilonewtons",
    0.22481: "pounds",
    3.5969: "ounces",
    1e5: "dynes",
    1e6: "micronewtons",
}
"""What a number in newtons becomes in another unit, times."""
LENGTH = {1e-3: "metres", 0.1: "centimetres", 1e3: "micrometres", 1 / 25.4: "inches"}
"""The same of a number in millimetres."""


class FindingRank(IntEnum):
    """How near a finding is to the cause; of two that explain each other the lower stands first."""

    FIELD = 0
    """The field itself cannot hold measured values: dead, frozen, clipped, missing, out of order."""
    RELATION = 1
    """Two fields of one pad contradict each other: a unit, a sign, an axis, a delay."""
    MACHINE = 2
    """Jaws, poses and clock contradict each other, or the pads' movement."""
    FRUIT = 3
    """Recording and mesh do not belong together."""


class FindingKind(StrEnum):
    """What was found; findings are told apart by this, never by the words of their sentences."""

    # the field itself
    DEAD_MARKERS = "dead-markers"
    ZERO_FRAMES = "zero-frames"
    COPIED_FRAMES = "copied-frames"
    COARSE_STEPS = "coarse-steps"
    CLIPPED = "clipped"
    NOISE = "noise"
    MARKERS_UNIT = "markers-unit"
    MARKERS_ORDER = "markers-order"
    MARKERS_MISSING = "markers-missing"
    MARKERS_PITCH_OFF = "markers-pitch-off"
    PITCH_NOT_OF_SENSOR = "pitch-not-of-sensor"
    OVER_EDGE = "over-edge"
    REFERENCE_PRINT = "reference-print"
    PRINT_WITHOUT_FORCE = "print-without-force"
    # force against displacement
    AXES = "axes"
    DEAD_FIELD = "dead-field"
    SIGN = "sign"
    DELAY = "delay"
    INCREMENTS = "increments"
    OUT_OF_STEP = "out-of-step"
    OTHER_MARKERS = "other-markers"
    SATURATION = "saturation"
    FORCE_UNIT = "force-unit"
    FORCE_SCALE = "force-scale"
    DISPLACEMENT_UNIT = "displacement-unit"
    DISPLACEMENT_SCALE = "displacement-scale"
    STIFFNESS_UNIT = "stiffness-unit"
    FORCE_OR_STIFFNESS_UNIT = "force-or-stiffness-unit"
    GAIN = "gain"
    """A factor whose cause is not known: of the force, of the displacement or of the stated stiffness."""
    STIFFNESS_NOT_OF_SENSOR = "stiffness-not-of-sensor"
    """The stated stiffness is not that of the named sensor."""
    FORCE_DRIFT = "force-drift"
    # time
    FRAMES_SHUFFLED = "frames-shuffled"
    GEL_FRAMES_SHUFFLED = "gel-frames-shuffled"
    CLOCKS_APART = "clocks-apart"
    TIME_UNIT = "time-unit"
    FRAMES_DROPPED = "frames-dropped"
    STARTS_IN_CONTACT = "starts-in-contact"
    ENDS_PRESSED = "ends-pressed"
    NO_TARE = "no-tare"
    LOGGER = "logger"
    # jaws and poses
    POSES_UNIT = "poses-unit"
    POSES_STILL = "poses-still"
    POSES_TRANSPOSED = "poses-transposed"
    POSES_INVERTED = "poses-inverted"
    POSES_BACK_TO_BACK = "poses-back-to-back"
    POSES_TURNED = "poses-turned"
    POSE_AWAY = "pose-away"
    APERTURE = "aperture"
    APERTURE_UNIT = "aperture-unit"
    TOO_DEEP = "too-deep"
    STIFFER_THAN_RIG = "stiffer-than-rig"
    BEYOND_RIG = "beyond-rig"
    # the fruit
    WIDTH = "width"
    ASIDE = "aside"
    PRINT_ASIDE = "print-aside"
    PADS_EXCHANGED = "pads-exchanged"
    MESH_TURNED = "mesh-turned"
    # what the recording says of itself
    READ_OTHERWISE = "read-otherwise"
    """Its reader took something otherwise than the file has it."""
    OTHER_FRUIT = "other-fruit"
    OTHER_CATEGORY = "other-category"


@dataclass(frozen=True)
class Finding:
    """`says` is the likely cause without a full stop; it goes on from the `pads` it is said of, if any.

    `field`: the field that is meant, where the kind may mean either; `detail`: what else tells two findings
    of a kind apart (a unit, a number of frames). `refused`: a modulus from this recording would mean
    nothing. Else E's relative standard deviation grows by `relative_sd`, which is 0 where E does not depend
    on what was found. `hides_touch`: the first touch cannot be seen for it, so that nothing can be said of
    where and when the pads met the fruit. `remark`: no fault and no effect on E, but something that other
    checks or findings would have needed. `has_effect`: the mismatch finder has an effect for the cause, so
    that it takes the recording though grading refuses it.
    """

    kind: FindingKind
    rank: FindingRank
    says: str
    _: KW_ONLY
    pads: tuple[str, ...] = ()
    field: Field | None = None
    detail: str = ""
    refused: bool = False
    relative_sd: float = 0.0
    hides_touch: bool = False
    remark: bool = False
    has_effect: bool = False

    @property
    def sentence(self) -> str:
        """The whole, as people read it.

        >>> kind, rank = FindingKind.SIGN, FindingRank.RELATION
        >>> Finding(kind, rank, "force is negative", pads=("left",)).sentence
        "the left pad's force is negative"
        """
        return f"{pads_said(self.pads)} {self.says}" if self.pads else self.says


def pads_said(names: tuple[str, ...]) -> str:
    """The pads as a sentence begins with them.

    >>> pads_said(("left",)), pads_said(("left", "right"))
    ("the left pad's", "both pads'")
    """
    return f"the {names[0]} pad's" if len(names) == 1 else "both pads'"


def shared(findings: Sequence[Finding]) -> list[Finding]:
    """The findings of two pads as one where they are of one kind, field and detail; the first's numbers."""
    if len(findings) == 2:
        first, second = findings
        same = (first.kind, first.field, first.detail) == (second.kind, second.field, second.detail)
        if same and first.pads != second.pads:
            return [replace(first, pads=(*first.pads, *second.pads))]
    return list(findings)


def unit_like(factor: float, units: Mapping[float, str]) -> str | None:
    """The unit whose factor this is, if it is one's.

    >>> unit_like(103.0, FORCE), unit_like(2.0, FORCE)
    ('grams', None)
    """
    if not factor > 0:
        return None
    apart = {name: abs(float(np.log(factor / times))) for times, name in units.items()}
    name = min(apart, key=lambda unit: apart[unit])
    return name if apart[name] < SIMILAR_FACTOR else None


def times_said(factor: float) -> str:
    """A factor in words.

    >>> times_said(102.3), times_said(0.5), times_said(0.00098)
    ('102 times', '0.50 times', '1/1020 of')
    """
    if factor < 0.05:
        return f"1/{1 / factor:.0f} of"
    return f"{factor:.0f} times" if factor >= 20 else f"{factor:.2f} times"

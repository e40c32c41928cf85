"""One thing that cannot be right in a recording: its cause as a sentence, and what it does to E."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum
from typing import Any, Literal

Field = Literal["displacement", "force", "stiffness"]
REFUSED_SD = 0.28
"""Relative standard deviation of E beyond which a modulus says too little: a gain of 1.5."""
MEANINGLESS = 1.0
"""The same of a recording whose fields are not what they say."""
E_OF_ANOTHER_FRUIT = 0.35
"""The same where the recording may be another fruit's: moduli of one lot spread by a factor of 1.4."""


class FindingKind(StrEnum):
    """What was found; findings are told apart by this, never by the words of their sentences."""

    # single values, markers and frames
    DEAD_MARKERS = "dead-markers"
    DEAD_FIELD = "dead-field"
    ZERO_FRAMES = "zero-frames"
    COPIED_FRAMES = "copied-frames"
    CLIPPED = "clipped"
    NOISE = "noise"
    MARKERS_MISSING = "markers-missing"
    MARKERS_PITCH_OFF = "markers-pitch-off"
    OVER_EDGE = "over-edge"
    REFERENCE_PRINT = "reference-print"
    PRINT_WITHOUT_FORCE = "print-without-force"
    STARTS_IN_CONTACT = "starts-in-contact"
    ENDS_PRESSED = "ends-pressed"
    NO_TARE = "no-tare"
    FORCE_DRIFT = "force-drift"
    TIME_UNIT = "time-unit"
    # transformations that explain a failed relation
    SCALE = "scale"
    """A factor on force, displacement or stiffness (`field`); `detail` names the unit, if it is one's."""
    SIGN = "sign"
    AXES = "axes"
    INCREMENTS = "increments"
    DELAY = "delay"
    SATURATION = "saturation"
    MARKERS_ORDER = "markers-order"
    MARKERS_UNIT = "markers-unit"
    FIELDS_EXCHANGED = "fields-exchanged"
    CLOCKS_APART = "clocks-apart"
    APERTURE_UNIT = "aperture-unit"
    POSES_UNIT = "poses-unit"
    POSES_STILL = "poses-still"
    POSES_TRANSPOSED = "poses-transposed"
    POSES_INVERTED = "poses-inverted"
    POSES_BACK_TO_BACK = "poses-back-to-back"
    PADS_EXCHANGED = "pads-exchanged"
    MESH_TURNED = "mesh-turned"
    # relations that fail, and that no transformation explains
    OUT_OF_STEP = "out-of-step"
    OTHER_MARKERS = "other-markers"
    FRAMES_SHUFFLED = "frames-shuffled"
    GEL_FRAMES_SHUFFLED = "gel-frames-shuffled"
    POSES_TURNED = "poses-turned"
    POSE_AWAY = "pose-away"
    APERTURE = "aperture"
    TOO_DEEP = "too-deep"
    STIFFNESS_NOT_OF_SENSOR = "stiffness-not-of-sensor"
    PITCH_NOT_OF_SENSOR = "pitch-not-of-sensor"
    UNBALANCED = "unbalanced"
    MODULUS = "modulus"
    WIDTH = "width"
    ASIDE = "aside"
    PRINT_ASIDE = "print-aside"
    # what the machine and the recording say of themselves
    STIFFER_THAN_RIG = "stiffer-than-rig"
    BEYOND_RIG = "beyond-rig"
    READ_OTHERWISE = "read-otherwise"
    """Its reader took something otherwise than the file has it."""
    OTHER_FRUIT = "other-fruit"
    OTHER_CATEGORY = "other-category"


@dataclass(frozen=True)
class Finding:
    """`says` is the likely cause without a full stop; it goes on from the `pads` it is said of, if any.

    `field`: the field that is meant, where the kind may mean either; `detail`: what else tells two findings
    of a kind apart (a unit, a number of frames). `also`: kinds of other causes that explain the recording
    about as well. `refused`: a modulus from this recording would mean nothing. Else E's relative standard
    deviation grows by `relative_sd`, which is 0 where E does not depend on what was found. `hides_touch`: the
    first touch cannot be seen for it, so that nothing can be said of where and when the pads met the fruit.
    `remark`: no fault and no effect on E, but something that other checks or findings would have needed.
    `has_effect`: the mismatch finder has an effect for the cause, so that it takes the recording though
    grading refuses it. `undone`: the recording is sound without it.
    """

    kind: FindingKind
    says: str
    _: KW_ONLY
    pads: tuple[str, ...] = ()
    field: Field | None = None
    detail: str = ""
    also: frozenset[FindingKind] = frozenset()
    refused: bool = False
    relative_sd: float = 0.0
    hides_touch: bool = False
    remark: bool = False
    has_effect: bool = False
    undone: bool = False

    @property
    def sentence(self) -> str:
        """The whole, as people read it.

        >>> Finding(FindingKind.SIGN, "force is negative", pads=("left",)).sentence
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


def doubted(kind: FindingKind, says: str, *, relative_sd: float, **more: Any) -> Finding:
    """The finding that adds `relative_sd` to E's error bar, refused beyond REFUSED_SD."""
    return Finding(kind, says, relative_sd=relative_sd, refused=relative_sd > REFUSED_SD, **more)


def times_said(factor: float) -> str:
    """A factor in words.

    >>> times_said(102.3), times_said(0.5), times_said(0.00098)
    ('102 times', '0.50 times', '1/1020 of')
    """
    if factor < 0.05:
        return f"1/{1 / factor:.0f} of"
    return f"{factor:.0f} times" if factor >= 20 else f"{factor:.2f} times"

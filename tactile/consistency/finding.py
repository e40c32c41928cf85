"""One contradiction in a recording: its cause as a sentence, and its effect on E."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from enum import StrEnum
from typing import Any, Literal

Field = Literal["displacement", "force", "stiffness"]
REFUSED_SD = 0.28
"""Relative standard deviation of E above which a recording is refused: that of a gain of 1.5."""
MEANINGLESS = 1.0
"""The same, for a recording whose fields are not what they claim to be."""
E_OF_ANOTHER_FRUIT = 0.35
"""The same if the recording may be of another fruit: moduli of one lot spread by a factor of 1.4."""


class FindingKind(StrEnum):
    """The kind of a finding; code distinguishes findings by it, never by the words of their sentences."""

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
    """A factor on force, displacement or stiffness (`field`); `detail` names the unit that it suggests, if
    any."""
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
    # limits of the machine, and statements about the recording
    STIFFER_THAN_RIG = "stiffer-than-rig"
    BEYOND_RIG = "beyond-rig"
    READ_OTHERWISE = "read-otherwise"
    """The reader interpreted something differently from the file."""
    OTHER_FRUIT = "other-fruit"
    OTHER_CATEGORY = "other-category"


@dataclass(frozen=True)
class Finding:
    """`says` is the likely cause without a full stop; it continues the names of the `pads`, if any.

    `field`: the field that is meant, where the kind may mean either; `detail`: distinguishes two findings of
    a kind (a unit, a number of frames). `also`: kinds of other causes that explain the recording about
    equally well. `refused`: a modulus from this recording would be meaningless. Otherwise E's relative
    standard deviation grows by `relative_sd`, which is 0 if E does not depend on the finding. `hides_touch`:
    the first touch cannot be detected, so no check can judge where and when the pads met the fruit. `remark`:
    no fault and no effect on E, but other checks or findings would have needed it. `has_effect`: the mismatch
    finder models the cause as an effect, so that it accepts the recording though grading refuses it.
    `undone`: the recording is valid once the cause is removed.
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
        """The whole sentence, for users.

        >>> Finding(FindingKind.SIGN, "force is negative", pads=("left",)).sentence
        "the left pad's force is negative"
        """
        return f"{pads_said(self.pads)} {self.says}" if self.pads else self.says


def pads_said(names: tuple[str, ...]) -> str:
    """The pads as the start of a sentence.

    >>> pads_said(("left",)), pads_said(("left", "right"))
    ("the left pad's", "both pads'")
    """
    return f"the {names[0]} pad's" if len(names) == 1 else "both pads'"


def shared(findings: Sequence[Finding]) -> list[Finding]:
    """The findings of two pads as one if kind, field and detail agree; its numbers are the first's."""
    if len(findings) == 2:
        first, second = findings
        same = (first.kind, first.field, first.detail) == (second.kind, second.field, second.detail)
        if same and first.pads != second.pads:
            return [replace(first, pads=(*first.pads, *second.pads))]
    return list(findings)


def doubted(kind: FindingKind, says: str, *, relative_sd: float, **more: Any) -> Finding:
    """A finding that adds `relative_sd` to E's error bar; beyond REFUSED_SD it refuses the recording."""
    return Finding(kind, says, relative_sd=relative_sd, refused=relative_sd > REFUSED_SD, **more)


def times_said(factor: float) -> str:
    """A factor in words.

    >>> times_said(102.3), times_said(0.5), times_said(0.00098)
    ('102 times', '0.50 times', '1/1020 of')
    """
    if factor < 0.05:
        return f"1/{1 / factor:.0f} of"
    return f"{factor:.0f} times" if factor >= 20 else f"{factor:.2f} times"

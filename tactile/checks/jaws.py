"""Poses against each other, against the aperture and against what the gel felt."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from tactile.checks.finding import LENGTH, Finding, FindingKind, FindingRank, unit_like
from tactile.checks.pressing import FEWEST_PRESSED, Pressing
from tactile.io.recording import Recording

FACING = 0.9
"""Cosine between one pad's normal and the other's reversed: 26 degrees. Parallel jaws have 1.000, mounts that
give way some degrees."""
OPENING_SAID_MM, OPENING_SHARE, E_OF_APERTURE = 0.3, 0.1, 0.2
"""Aperture against the poses' distance, in mm and of what the jaws close; recordings here agree to 1e-6 mm.
Relative error of E: taken, not measured, since it is not known which of the two is wrong."""
LEAST_MOVED_MM, MOVED = 0.3, 0.2
"""Poses that move by less than this share of an aperture's change of so many mm stand still: parallel jaws
share it by half each, so that sound poses move by all of it."""
FAR_TOO_NEAR = 0.5
"""Pads that never come farther apart than this share of the fruit's mean size, which they should hold."""
OVER_CLOSING, SLACK_MM = 1.2, 0.15
"""The gel cannot be indented by more than its jaw has gone past the first touch: sound ones have 0.55 of it
and less (benchmarks/field_spreads.py); the touch is known to a frame's step, some 0.15 mm."""


def closing_mm(press: Pressing) -> float:
    """How far the pad goes past its first touch (the last frame before any marker is pressed)."""
    pressed = press.pressed.sum(axis=1) >= FEWEST_PRESSED
    if not pressed.any():
        return 0.0
    way = press.closing_mm
    return float(way.max() - way[max(int(np.argmax(pressed)) - 1, 0)])


def jaw_findings(
    recording: Recording,
    pressings: Sequence[Pressing],
    *,
    centre_mm: Float[np.ndarray, " 3"],
    size_mm: float,
) -> list[Finding]:
    """What poses say of each other, of the aperture and of the fruit's middle and size."""
    findings: list[Finding] = []
    poses = [press.pad.pose for press in pressings]
    if recording.loading == "grasp" and len(poses) == 2:
        first = [pose[0] for pose in poses]
        if not _facing(first):
            return [_wrong_way(first)]
        findings += _aperture(recording, poses, size_mm=size_mm)
    for press in pressings if not findings else ():
        pose = press.pad.pose[0]
        if float(pose[:3, 2] @ (centre_mm - pose[:3, 3])) < 0:
            says = (
                "pose has its z axis pointing away from the fruit; z must point out of the gel into the fruit"
            )
            findings.append(_refused(FindingKind.POSE_AWAY, says, pads=(press.pad.name,)))
    return findings


def indentation_findings(pressings: Sequence[Pressing]) -> list[Finding]:
    """A gel that is indented by more than its jaw went."""
    findings = []
    for press in pressings:
        felt = float(np.quantile(np.abs(press.felt_mm[:, :, 2]).max(axis=0), 0.98))
        closing = closing_mm(press)
        if felt > OVER_CLOSING * closing + SLACK_MM and press.pressed.any():
            says = (
                f"gel is indented by {felt:.2f} mm although its jaw moves only {closing:.2f} mm past first "
                "contact: displacement or poses are scaled, or from another recording"
            )
            findings.append(_refused(FindingKind.TOO_DEEP, says, pads=(press.pad.name,)))
    return findings


def _aperture(
    recording: Recording, poses: Sequence[Float[np.ndarray, "t 4 4"]], *, size_mm: float
) -> list[Finding]:
    """Findings where the pads' poses and the recorded aperture disagree (unit, standing still, an offset)."""
    between = np.einsum("ti,i->t", poses[1][:, :3, 3] - poses[0][:, :3, 3], poses[0][0, :3, 2])
    stated = recording.aperture_mm
    moved, said = float(np.ptp(between)), float(np.ptp(stated))
    apart = float(np.ptp(stated - between))
    unit = unit_like(moved / max(said, 1e-12), LENGTH)
    if unit and float(np.abs(between).max()) < FAR_TOO_NEAR * size_mm:
        says = (
            f"the poses look like {unit}: they place the pads {between.max():.3g} mm apart, around a fruit "
            f"of {size_mm:.0f} mm"
        )
        return [_refused(FindingKind.POSES_UNIT, says, detail=unit)]
    if said > LEAST_MOVED_MM and moved < MOVED * said:
        says = (
            f"the poses stand still (they move {moved:.2f} mm) while the aperture changes by {said:.2f} mm: "
            "poses of one instant, or of another recording"
        )
        return [_refused(FindingKind.POSES_STILL, says)]
    if apart <= max(OPENING_SAID_MM, OPENING_SHARE * said):
        return []
    scale = moved / max(said, 1e-12)
    unit = unit_like(scale, {1 / times: name for times, name in LENGTH.items()})
    kind, what, sd = FindingKind.APERTURE_UNIT, f"aperture_mm looks like {unit}", 0.0
    if not unit:
        kind, sd = FindingKind.APERTURE, E_OF_APERTURE
        what = "aperture and poses disagree (from another recording, or with another clock)"
    says = (
        f"{what}: the pads' poses close by {moved:.2f} mm, the aperture by {said:.2f} mm, and they differ by "
        f"up to {apart:.2f} mm"
    )
    return [Finding(kind, FindingRank.MACHINE, says, detail=unit or "", relative_sd=sd)]


def _facing(poses: Sequence[Float[np.ndarray, "4 4"]]) -> bool:
    """Whether two pads look at each other."""
    line = poses[1][:3, 3] - poses[0][:3, 3]
    normals = [pose[:3, 2] for pose in poses]
    return -float(normals[0] @ normals[1]) >= FACING and min(normals[0] @ line, -normals[1] @ line) >= 0


def _transposed(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    turned = pose.copy()
    turned[:3, :3] = pose[:3, :3].T
    return turned


def _backward(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    return np.asarray(pose * np.array([1.0, 1.0, -1.0, 1.0]))


UNDONE: tuple[tuple[FindingKind, Callable[[np.ndarray], np.ndarray], str], ...] = (
    (
        FindingKind.POSES_TRANSPOSED,
        _transposed,
        "the poses' rotations are transposed (fruit to pad instead of pad to fruit): the pads face each "
        "other only after transposition",
    ),
    (
        FindingKind.POSES_INVERTED,
        np.linalg.inv,
        "the poses are inverted (fruit to pad instead of pad to fruit)",
    ),
    (
        FindingKind.POSES_BACK_TO_BACK,
        _backward,
        "the poses put the pads back to back: the z axes point away from each other. z must point out of "
        "the gel into the fruit, or the poses of left and right are swapped",
    ),
)
"""Mistakes in poses, likeliest first: what undoes each, so that the pads face each other, and its words."""


def _wrong_way(poses: Sequence[Float[np.ndarray, "4 4"]]) -> Finding:
    """Normals that do not face each other: which mistake, undone, makes them."""
    for kind, undo, says in UNDONE:
        if _facing([undo(pose) for pose in poses]):
            return _refused(kind, says)
    says = (
        "the pads do not face each other in their poses: rotations are transposed, or the poses are from "
        "another day"
    )
    return _refused(FindingKind.POSES_TURNED, says)


def _refused(kind: FindingKind, says: str, *, pads: tuple[str, ...] = (), detail: str = "") -> Finding:
    return Finding(kind, FindingRank.MACHINE, says, pads=pads, detail=detail, refused=True)

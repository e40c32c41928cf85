"""Poses of the two pads of a gripper that closes in a straight line, from its aperture alone."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactile.readers.recording import Converted, GelPad
from tactile.tactile_failure import TactileProblem

LEAST_ANGLE_SINE = 0.1
"""Least sine of the angle between `closing` and `up` (6 degrees) at which they determine the pads' rotation.
Set by hand."""


@dataclass(frozen=True, kw_only=True)
class Jaws:
    """Two jaws that close in a straight line, in the fruit frame: `jaw_poses` defines the fields."""

    centre_mm: tuple[float, float, float]
    closing: tuple[float, float, float]
    up: tuple[float, float, float]


def posed_by_jaws(converted: Converted, jaws: Jaws, *, source: str) -> Converted:
    """The recording with poses from its aperture.

    Raises TactileFailure (unreadable-frames) for a recording that has poses, is no grasp between two gels, or
    has a constant aperture.
    """
    held = converted.recording
    pads = [pad for pad in held.pads if isinstance(pad, GelPad)]
    faults = {
        "a press or a bare indenter, expected a grasp between two gels": len(pads) != 2,
        "poses, expected none": any((pad.pose != np.eye(4)).any() for pad in pads),
        "an aperture that does not change, expected that of the jaws": not np.ptp(held.aperture_mm) > 0,
    }
    for fault, applies in faults.items():
        if applies:
            advice = "leave out --jaws-centre-mm, or correct the source"
            raise TactileProblem.UNREADABLE_FRAMES.failure(f"{source}: found {fault}; {advice}.")
    directions = {name: np.array(value, dtype=np.float64) for name, value in vars(jaws).items()}
    poses = jaw_poses(held.aperture_mm, **directions)
    posed = tuple(replace(pad, pose=pose) for pad, pose in zip(pads, poses, strict=True))
    note = f"{source}: poses follow from the aperture of two jaws that close in a straight line."
    return Converted(recording=replace(held, pads=posed), notes=(*converted.notes, note))


def jaw_poses(
    aperture_mm: Float[np.ndarray, " t"],
    *,
    centre_mm: Float[np.ndarray, "3"],
    closing: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "t 4 4"], Float[np.ndarray, "t 4 4"]]:
    """Pad frame to fruit frame of the left and the right pad, which close symmetrically about a centre.

    z_left = closing, z_right = -closing, y = up (its part normal to `closing`), x = y x z; the origins are at
    centre_mm -/+ closing aperture_mm / 2. `closing` and `up` are directions of any length in the fruit frame.
    Only the change of the aperture enters E: the centre and the directions determine which skin the pads
    touch.

    Raises TactileFailure (unreadable-recording) if `closing` and `up` are (nearly) parallel or zero, or an
    aperture is negative.
    """
    if aperture_mm.min(initial=0.0) < 0:
        raise TactileProblem.UNREADABLE_RECORDING.failure(
            f"aperture_mm: found {aperture_mm.min():g} mm, expected 0 or more; give the distance between the "
            "two undeformed gel faces."
        )
    length, height = float(np.linalg.norm(closing)), float(np.linalg.norm(up))
    along = closing / (length or 1.0)
    across = up - (up @ along) * along
    if not np.linalg.norm(across) > LEAST_ANGLE_SINE * height > 0 or not length > 0:
        raise TactileProblem.UNREADABLE_RECORDING.failure(
            f"closing, up: found {closing.tolist()} and {up.tolist()}, expected two directions across each "
            "other; give the direction from the left jaw to the right jaw, and the pads' y axis.",
        )
    y = across / np.linalg.norm(across)
    poses = []
    for z in (along, -along):
        pose = np.tile(np.eye(4), (len(aperture_mm), 1, 1))
        pose[:, :3, 0], pose[:, :3, 1], pose[:, :3, 2] = np.cross(y, z), y, z
        pose[:, :3, 3] = centre_mm - aperture_mm[:, None] / 2 * z
        poses.append(pose)
    return poses[0], poses[1]

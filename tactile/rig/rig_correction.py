"""A bare trace's travel less what the rig gives by itself."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactile.io.converted import Converted
from tactile.io.recording import IndenterPad, Recording
from tactile.rig.rig_curve import MOST_BEYOND, RigCurve
from tactile.rig.rigid_squeeze import UNLOADED_FRAMES
from tactile.tactile_failure import TactileFailure, TactileProblem


def without_rig(recording: Recording, curve: RigCurve, *, source: str, named: str) -> Converted:
    """The trace with travel less give(F), F counted from the load cell's reading in the first frames.

    The recording keeps both the give and its standard deviation in each frame (`rig_give_mm`, `rig_sd_mm`),
    from which the spread goes into E. Raises TactileFailure (unreadable-recording) where the recording is no
    bare press, was corrected before, or goes beyond what the curve says.
    """
    pad = recording.pads[0]
    if not isinstance(pad, IndenterPad) or len(recording.pads) != 1:
        raise _refused(
            source, "pads with markers", "the curve of a bare indenter; name the rig in batch.toml"
        )
    if recording.rig_give_mm is not None:
        raise _refused(source, "a travel that is already corrected for a rig", "the travel as recorded")
    force = pad.force_z_N - float(np.median(pad.force_z_N[:UNLOADED_FRAMES]))
    largest = float(force.max())
    if not curve.reaches(largest):
        raise _refused(
            source,
            f"a maximum force of {largest:.3g} N, but {named} is calibrated up to {curve.largest_N:.3g} N",
            f"at most {MOST_BEYOND:g} times that; squeeze the rigid object equally hard, and calibrate again",
        )
    give, sd = curve.give(force), curve.sd(force)
    closing = -1.0 if recording.loading == "grasp" else 1.0
    corrected = replace(
        recording, aperture_mm=recording.aperture_mm - closing * give, rig_give_mm=give, rig_sd_mm=sd
    )
    at = int(np.argmax(force))
    travel = closing * recording.aperture_mm
    notes = [
        (
            f"{source}: of {float(travel[at] - travel[_touched(force)]):.3g} mm of travel since first "
            f"contact, {give[at]:.3g} ± {sd[at]:.2g} mm at {largest:.3g} N belong to the rig ({named}); "
            "drupe subtracted them."
        )
    ]
    if largest > curve.largest_N:
        notes.append(
            f"{source}: {named} is calibrated up to {curve.largest_N:.3g} N. Up to {largest:.3g} N "
            "drupe extrapolated by its last slope, with a growing standard deviation."
        )
    return Converted(recording=corrected, notes=tuple(notes))


def _touched(force: Float[np.ndarray, " t"]) -> int:
    """The last frame before the peak in which less than a fiftieth of the largest force is felt."""
    peak = int(np.argmax(force))
    below = np.flatnonzero(force[: peak + 1] < 0.02 * force[peak])
    return int(below[-1]) if len(below) else 0


def _refused(source: str, found: str, expected: str) -> TactileFailure:
    return TactileFailure(
        TactileProblem.UNREADABLE_RECORDING, f"{source}: found {found}, expected {expected}."
    )

"""Displacement of a rig under load and its standard deviation; a force-displacement curve without it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from tactile.readers.load_cell import UNLOADED_FRAMES
from tactile.readers.recording import Converted, IndenterPad, Recording
from tactile.tactile_failure import TactileFailure, TactileProblem

MOST_BEYOND = 1.25
"""Largest force for extrapolation over the largest calibrated one, F. Set by hand: the standard deviation
there includes an eighth of F times the last slope."""

TOUCHED = 0.02
"""Share of the largest force from which the object is touched. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class RigCurve:
    """`give_mm`: displacement of the rig at the knots `force_N` (from 0 up), with standard deviation `sd_mm`.

    Monotone cubics interpolate both (PCHIP: Fritsch and Carlson, "Monotone piecewise cubic interpolation",
    SIAM J. Numer. Anal. 17, 1980, 238-246), so the displacement grows with the force as the knots do. Beyond
    the last knot it grows with its last slope. A rig that stiffens moves no farther than that, and no less
    than at the last knot. The standard deviation therefore grows by half of the added displacement.
    """

    force_N: Float[np.ndarray, " k"]
    give_mm: Float[np.ndarray, " k"]
    sd_mm: Float[np.ndarray, " k"]

    @property
    def largest_N(self) -> float:
        """The largest calibrated force."""
        return float(self.force_N[-1])

    def give(self, force_N: Float[np.ndarray, "*t"]) -> Float[np.ndarray, "*t"]:
        """Displacement of the rig, mm; 0 for forces below 0.

        >>> knots = {"force_N": np.array([0.0, 10, 20]), "give_mm": np.array([0.0, 0.1, 0.2])}
        >>> RigCurve(**knots, sd_mm=np.zeros(3)).give(np.array([5.0, 30.0])).round(6)
        array([0.05, 0.3 ])
        """
        inside = np.clip(force_N, 0.0, self.largest_N)
        curve = PchipInterpolator(self.force_N, self.give_mm)
        return np.asarray(curve(inside) + self.last_mm_per_N * np.maximum(force_N - self.largest_N, 0.0))

    def sd(self, force_N: Float[np.ndarray, "*t"]) -> Float[np.ndarray, "*t"]:
        """One standard deviation of `give`, mm."""
        inside = np.clip(force_N, 0.0, self.largest_N)
        curve = PchipInterpolator(self.force_N, self.sd_mm)
        beyond = np.maximum(force_N - self.largest_N, 0.0)
        return np.asarray(curve(inside) + 0.5 * self.last_mm_per_N * beyond)

    @property
    def last_mm_per_N(self) -> float:
        """Slope between the last two knots, with which the curve is extrapolated."""
        return float((self.give_mm[-1] - self.give_mm[-2]) / (self.force_N[-1] - self.force_N[-2]))

    def reaches(self, force_N: float) -> bool:
        """Whether the curve, with its extrapolation, covers this force."""
        return force_N <= MOST_BEYOND * self.largest_N

    def plus(self, deviations: float) -> "RigCurve":
        """The curve of a more or less compliant rig, by so many standard deviations; it never falls."""
        give = np.maximum.accumulate(np.maximum(self.give_mm + deviations * self.sd_mm, 0.0))
        return RigCurve(force_N=self.force_N, give_mm=give, sd_mm=self.sd_mm)


def without_rig(recording: Recording, curve: RigCurve, *, source: str, named: str) -> Converted:
    """The force-displacement curve with travel minus give(F); F counts from the load cell's first readings.

    The recording keeps the subtracted displacement and its standard deviation in each frame (`rig_give_mm`,
    `rig_sd_mm`), which enter the error of E. Raises TactileFailure (unreadable-recording) if the recording is
    no bare press, is already corrected, or exceeds the curve's forces.
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
    since = float(travel[at] - travel[first_touch(force, TOUCHED)])
    notes = [
        (
            f"{source}: of {since:.3g} mm of travel since first "
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


def first_touch(force: Float[np.ndarray, " t"], share: float) -> int:
    """The last frame before the peak with a force below this share of the largest; the first without any."""
    peak = int(np.argmax(force))
    below = np.flatnonzero(force[: peak + 1] < share * force[peak])
    return int(below[-1]) if len(below) else 0


def _refused(source: str, fault: str, expected: str) -> TactileFailure:
    return TactileProblem.UNREADABLE_RECORDING.failure(f"{source}: found {fault}, expected {expected}.")

"""A recording's gel against what is known of its sensor: stiffness per area, and pitch of the markers.

Forces that were computed with a wrong stiffness fit it exactly, so that no other check sees it; nor does one
see a wrong scale of the gel's pictures that enters displacement and force alike.
"""

from collections.abc import Sequence

import numpy as np

from tactile.checks.finding import Finding, FindingKind, FindingRank, shared
from tactile.io.recording import GelPad, marker_area_mm2
from tactile.io.sensor_model import PublishedGel

FAR_SD = 3.0
"""Standard deviations beyond which a gel is not taken to be the sensor's: one sound gel in 370."""
E_PER_PITCH = 2.2
"""Error of ln E per ln of the pictures' scale where it enters all lengths and the forces of springs with its
third power: 0.21 at 1.1 (benchmarks/field_mistakes.py --grade --only "picture scale"). Where it enters the
markers' places alone and the forces with its square, 0.8."""


def gel_findings(pads: Sequence[GelPad], known: PublishedGel) -> list[Finding]:
    """Stiffness and pitch that are further than FAR_SD from what is known; both pads in one sentence.

    Where both stiffnesses of a pad are wrong, only the first is named.
    """
    of_stiffness = [finding for pad in pads if (finding := _stiffness(pad, known)) is not None]
    of_pitch = [finding for pad in pads if (finding := _pitch(pad, known)) is not None]
    return shared(of_stiffness) + shared(of_pitch)


def measured_pitch_mm(pad: GelPad) -> float | None:
    """Root of the face that belongs to one marker; None where too few markers show it."""
    area_mm2 = marker_area_mm2(pad.rest_mm)
    return None if area_mm2 is None else float(np.sqrt(area_mm2))


def _stiffness(pad: GelPad, known: PublishedGel) -> Finding | None:
    for name, (expected, sd) in known.stiffness.items():
        stated: float = getattr(pad, name)
        off = abs(float(np.log(stated / expected)))
        if off > FAR_SD * sd:
            says = (
                f"{name} is {stated:g}, but {known.source} has {expected:.3g} ± {100 * sd:.2g} % "
                f"({off / sd:.1f} standard deviations). E has the same relative error if the forces use this "
                "value. Correct it, or state the gel's own under [sensor] in batch.toml"
            )
            return _finding(pad, FindingKind.STIFFNESS_NOT_OF_SENSOR, says, off)
    return None


def _pitch(pad: GelPad, known: PublishedGel) -> Finding | None:
    pitch = measured_pitch_mm(pad)
    if pitch is None or known.pitch_mm is None:
        return None
    off = abs(float(np.log(pitch / known.pitch_mm)))
    if off <= FAR_SD * known.pitch_sd:
        return None
    says = (
        f"markers are {pitch:.3g} mm apart, but {known.source} has {known.pitch_mm:.3g} mm ± "
        f"{100 * known.pitch_sd:.2g} %. Either the scale of the gel's pictures is wrong (in displacement and "
        "forces), or the sensor has another gel. Calibrate the sensor's camera"
    )
    return _finding(pad, FindingKind.PITCH_NOT_OF_SENSOR, says, E_PER_PITCH * off)


def _finding(pad: GelPad, kind: FindingKind, says: str, relative_sd: float) -> Finding:
    return Finding(kind, FindingRank.RELATION, says, pads=(pad.name,), relative_sd=relative_sd)

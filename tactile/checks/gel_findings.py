"""A recording's gel: prints on the picture of it untouched, prints that come with no force, and stiffness per
area and pitch of the markers against what is known of its sensor.

Forces that were computed with a wrong stiffness fit it exactly, so that no other check sees it; nor does one
see a wrong scale of the gel's pictures that enters displacement and force alike.
"""

from collections.abc import Sequence

import numpy as np

from tactile.checks.finding import Finding, FindingKind, FindingRank, shared
from tactile.io.recording import GelPad, marker_area_mm2
from tactile.io.sensor_model import PublishedGel
from tactile.noise import noise_in_contact
from tactile.reference_print import SURE, WHAT_TO_DO

E_OF_A_PRINT = 0.5
"""Relative standard deviation of E where a reference may bear a print: displacements then lack that of the
print, which may be all of them. Set by hand."""
FORCE_BEYOND_NOISE = 8.0
"""Standard deviations of a pad's total normal force below which it feels nothing, as tactile.contact has
it."""
LEAST_PRINT_N = 0.05
"""Total normal force below which a print cannot be seen: a twentieth of a face of 300 mm2 of a gel of 0.2 MPa
that is pressed in by a thirtieth of its thickness has 0.1 N; half of it. Set by hand."""
FAR_SD = 3.0
"""Standard deviations beyond which a gel is not taken to be the sensor's: one sound gel in 370."""
E_PER_PITCH = 2.2
"""Error of ln E per ln of the pictures' scale where it enters all lengths and the forces of springs with its
third power: 0.21 at 1.1 (benchmarks/field_mistakes.py --grade --only "picture scale"). Where it enters the
markers' places alone and the forces with its square, 0.8."""


def reference_findings(pads: Sequence[GelPad]) -> list[Finding]:
    """Prints on references, and prints without a force; of both pads said once."""
    return shared([finding for pad in pads for finding in _print_findings(pad)])


def print_without_force(pad: GelPad) -> str | None:
    """Why a pad whose pictures show a print feels nothing, with what to do; None where that is not so."""
    shown = 0.0 if pad.print_shown is None else float(pad.print_shown.max())
    on_reference = pad.reference_print is not None and pad.reference_print >= 1.0
    if not on_reference and shown < SURE:
        return None
    total = pad.force_N[:, :, 2].sum(axis=1)
    noise = noise_in_contact(pad.force_N).sd * float(np.sqrt(len(pad.rest_mm)))
    if float(total.max()) > max(FORCE_BEYOND_NOISE * noise, LEAST_PRINT_N):
        return None
    what_to_do = WHAT_TO_DO
    if pad.reference_sd_mm is not None:
        spread_mm = float(np.sqrt((pad.reference_sd_mm**2).mean()))
        cause = (
            f"the estimate of the untouched gel has a standard deviation of {spread_mm:.2g} mm, "
            "too coarse for the force of this imprint"
        )
        what_to_do = "name a picture or a clip of the empty gel (reference = ... in grasp.toml)"
    elif on_reference:
        cause = "the reference shows a contact imprint itself"
    elif pad.print_shown is not None and pad.print_shown[0] >= SURE:
        cause = "the gel is under load from frame 0 on, and the reference does not show this gel untouched"
    else:
        cause = (
            "the reference or the sensor's description is of another gel, or shear exceeds pressure "
            "(one camera measures no depth)"
        )
    pictured = f"pictures show a contact imprint ({shown:.1f} times the limit for an empty gel), yet its "
    shows = pictured if shown >= SURE else ""
    return f"{shows}force is at most {max(float(total.max()), 0.0):.2g} N: {cause}; {what_to_do}"


def _print_findings(pad: GelPad) -> list[Finding]:
    rank, pads = FindingRank.FIELD, (pad.name,)
    if (contradiction := print_without_force(pad)) is not None:
        return [Finding(FindingKind.PRINT_WITHOUT_FORCE, rank, contradiction, pads=pads, refused=True)]
    if pad.reference_print is None or pad.reference_print < 1.0:
        return []
    says = (
        f"reference shows a contact imprint ({pad.reference_print:.1f} times the limit for an empty gel), so "
        f"displacements are not relative to the untouched gel; {WHAT_TO_DO}"
    )
    kind, refused = FindingKind.REFERENCE_PRINT, pad.reference_print >= SURE
    sd = E_OF_A_PRINT
    return [Finding(kind, rank, says, pads=pads, refused=refused, relative_sd=sd, hides_touch=True)]


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

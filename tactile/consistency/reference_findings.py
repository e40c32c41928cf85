"""Contact imprints on the picture of the untouched gel, and imprints without a force."""

from collections.abc import Sequence

import numpy as np

from tactile.consistency.finding import Finding, FindingKind, shared
from tactile.noise import noise_in_contact
from tactile.readers.recording import GelPad
from tactile.reference_print import SURE, WHAT_TO_DO

E_OF_A_PRINT = 0.5
"""Relative standard deviation of E if a reference may show an imprint: displacements then lack the imprint's,
which may be all of it. Set by hand."""
FORCE_BEYOND_NOISE = 8.0
"""Standard deviations of a pad's total normal force below which it measures none, as in tactile.contact."""
LEAST_PRINT_N = 0.05
"""Total normal force below which an imprint is invisible. Pressing a twentieth of a face of 300 mm2 of a gel
of 0.2 MPa in by a thirtieth of its thickness takes 0.1 N; this is half of it. Set by hand."""


def reference_findings(pads: Sequence[GelPad]) -> list[Finding]:
    """Imprints on references, and imprints without a force; both pads share one finding."""
    return shared([finding for pad in pads for finding in _print_findings(pad)])


def print_without_force(pad: GelPad) -> str | None:
    """Why a pad whose pictures show an imprint measures no force, with advice; None if that is not so."""
    shown = 0.0 if pad.print_shown is None else float(pad.print_shown.max())
    on_reference = pad.reference_print is not None and pad.reference_print >= 1.0
    if not on_reference and shown < SURE:
        return None
    total = pad.force_N[:, :, 2].sum(axis=1)
    noise = noise_in_contact(pad.force_N).sd * float(np.sqrt(len(pad.rest_mm)))
    if float(total.max()) > max(FORCE_BEYOND_NOISE * noise, LEAST_PRINT_N):
        return None
    if on_reference:
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
    return f"{shows}force is at most {max(float(total.max()), 0.0):.2g} N: {cause}; {WHAT_TO_DO}"


def _print_findings(pad: GelPad) -> list[Finding]:
    if (contradiction := print_without_force(pad)) is not None:
        return [Finding(FindingKind.PRINT_WITHOUT_FORCE, contradiction, pads=(pad.name,), refused=True)]
    if pad.reference_print is None or pad.reference_print < 1.0:
        return []
    says = (
        f"reference shows a contact imprint ({pad.reference_print:.1f} times the limit for an empty gel), so "
        f"displacements are not relative to the untouched gel; {WHAT_TO_DO}"
    )
    return [
        Finding(
            FindingKind.REFERENCE_PRINT,
            says,
            pads=(pad.name,),
            refused=pad.reference_print >= SURE,
            relative_sd=E_OF_A_PRINT,
            hides_touch=True,
        )
    ]

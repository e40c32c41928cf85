"""A fruit that is stiffer than the jaws: its part of their travel is within the rig's uncertainty."""

import numpy as np

from tactile.consistency.finding import Finding, FindingKind
from tactile.consistency.pressing import DEEPEST
from tactile.readers.recording import GelPad, Recording
from tactile.rig.rig_curve import RigCurve

UNSURE = 0.3
"""Standard deviation of the jaws' displacement under force over the fruit's, above which E is a lower bound,
as for a bare indenter (fem.indentation.rig_share.UNSURE). Set by hand."""
TOUCHED = 0.05
"""Share of the largest force from which the pads are in contact. Set by hand."""


def jaw_share_findings(recording: Recording, rig: RigCurve) -> list[Finding]:
    """Whether the rig is too uncertain for a recording that was corrected for it; empty if it is not.

    The fruit's deformation is the travel from the first touch to the largest force minus the gels'
    indentation. E's error holds the spread itself (pipeline.fruit.repeated_modulus), so that the finding adds
    none.
    """
    pads = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    if len(pads) != len(recording.pads):
        return []
    force = np.mean([pad.force_N[:, :, 2].sum(axis=1) for pad in pads], axis=0)
    peak = int(np.argmax(force))
    below = np.flatnonzero(force[: peak + 1] < TOUCHED * force[peak])
    touch = int(below[-1]) if len(below) else 0
    closing = -1.0 if recording.loading == "grasp" else 1.0
    travel = closing * float(recording.aperture_mm[peak] - recording.aperture_mm[touch])
    gels = sum(float(np.quantile(-pad.displacement_mm[peak, :, 2], DEEPEST)) for pad in pads)
    fruit = travel - gels
    jaws, sd = (float(of(force[peak : peak + 1])[0]) for of in (rig.give, rig.sd))
    said = (
        f"at {force[peak]:.3g} N the machine compliance takes {jaws:.2g} ± {sd:.1g} mm and the "
        f"fruit {fruit:.2g} mm"
    )
    findings = []
    if sd > UNSURE * max(fruit, 0.0):
        says = f"{said}: it is too stiff for this rig, and E is a lower bound"
        findings.append(Finding(FindingKind.STIFFER_THAN_RIG, says))
    if force[peak] > rig.largest_N:
        says = (
            f"the rig calibration ends at {rig.largest_N:.3g} N; drupe extrapolated it to {force[peak]:.3g} N"
        )
        findings.append(Finding(FindingKind.BEYOND_RIG, says, remark=True))
    return findings

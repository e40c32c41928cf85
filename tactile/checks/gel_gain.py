"""By which factor forces may exceed what the gel's law says at its displacement, with the error of that.

A gain of force up to the limit of the check (tactile/checks/gain_findings.py) is not reported. The relation
of force and displacement (tactile/checks/relation.py) measures it all the same, in every recording.
"""

from collections.abc import Sequence

import numpy as np

from tactile.checks.gain_findings import GAIN_SAID
from tactile.checks.pressing import pressing_of
from tactile.checks.relation import relation_of
from tactile.io.recording import GelPad
from tactile.unseen_error import unseen_error

GAIN_SD = GAIN_SAID / 2
"""Prior standard deviation of ln gain: the check's limit is two of them (assumed)."""
LAW_SD = 0.015
"""Standard deviation of a pad's measured ln gain beyond its noise, from the law itself: half of the 0.03 that
sound recordings reach (benchmarks/field_spreads.py)."""


def unseen_gain(pads: Sequence[GelPad]) -> float:
    """Root mean square of ln gain, given all pads of all recordings.

    The measured ln gains of n pads, each of variance s^2 = LAW_SD^2 + noise, have a mean of variance
    mean(s^2) / n; the prior is N(0, GAIN_SD^2). Without a pad that says anything the prior is all there is.
    A gain that the check reports counts as none here: the finding has an error of its own.
    """
    found = [one for pad in pads if (one := _of_pad(pad)) is not None]
    if not found:
        return GAIN_SD
    measured, sd = np.transpose(found)
    measured = np.where(np.abs(measured) > GAIN_SAID, 0.0, measured)
    mean_sd = float(np.sqrt(np.mean(sd**2 + LAW_SD**2) / len(found)))
    return unseen_error(float(measured.mean()), mean_sd, prior_sd=GAIN_SD)


def _of_pad(pad: GelPad) -> tuple[float, float] | None:
    """ln gain and its standard deviation by noise; None where the gel's law says nothing of the pad."""
    relation = relation_of(pressing_of(pad))
    if relation is None or not relation.gain > 0:
        return None
    return float(np.log(relation.gain)), relation.gain_sd

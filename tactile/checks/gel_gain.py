"""By which factor forces may exceed what the gel's law says at its displacement, with the error of that.

A gain of force up to the limit of the check (tactile/checks/gain_findings.py) is not reported. The relation
of force and displacement (tactile/checks/relation.py) measures it all the same, in every recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactile.checks.gain_findings import GAIN_SAID, unseen_error
from tactile.checks.pressing import pressing_of
from tactile.checks.relation import relation_of
from tactile.io.recording import GelPad

GAIN_SD = GAIN_SAID / 2
"""Prior standard deviation of ln gain: the check's limit is two of them (assumed)."""
LAW_SD = 0.015
"""Standard deviation of a measured ln gain beyond its noise, from the law itself, which all pads of one gel
share: half of the 0.03 that sound recordings reach (benchmarks/field_spreads.py)."""


@dataclass(frozen=True, kw_only=True)
class UnseenGain:
    """Root mean square of ln gain in two independent parts: what all recordings of the gripper `shared`, and
    what differs between recordings, `independent`.
    """

    shared: float
    independent: float = 0.0


def unseen_gain(pads: Sequence[GelPad]) -> UnseenGain:
    """Of all pads of all recordings; without a pad that says anything the prior is all there is. A gain that
    the check reports counts as none here: the finding has an error of its own.
    """
    gains = [gain for pad in pads if (gain := _of_pad(pad)) is not None]
    if not gains:
        return UnseenGain(shared=GAIN_SD)
    measured, noise_sd = np.transpose(gains)
    return gain_left(np.where(np.abs(measured) > GAIN_SAID, 0.0, measured), noise_sd)


def gain_left(measured: Float[np.ndarray, " n"], noise_sd: Float[np.ndarray, " n"]) -> UnseenGain:
    """What n measured ln gains leave of one that is not corrected.

    Their mean m has the variance s^2 = LAW_SD^2 + mean(noise_sd^2) / n: the law's error does not average
    out. The prior is N(0, GAIN_SD^2), w the weight of m. The mean square (w m)^2 + w s^2
    (tactile.checks.gain_findings) is
    independent^2 + shared^2, where independent = w * noise is what the noise makes of w m.
    """
    noise = float(np.sqrt(np.mean(noise_sd**2) / len(noise_sd)))
    sd = float(np.hypot(LAW_SD, noise))
    independent = GAIN_SD**2 / (GAIN_SD**2 + sd**2) * noise
    return UnseenGain(
        shared=float(
            np.sqrt(unseen_error(float(measured.mean()), sd, prior_sd=GAIN_SD) ** 2 - independent**2)
        ),
        independent=independent,
    )


def _of_pad(pad: GelPad) -> tuple[float, float] | None:
    """ln gain and its standard deviation by noise; None where the gel's law says nothing of the pad."""
    relation = relation_of(pressing_of(pad))
    if relation is None or not relation.gain > 0:
        return None
    return float(np.log(relation.gain)), relation.gain_sd

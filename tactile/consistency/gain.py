"""Factor by which forces may exceed the gel law's prediction at the measured displacement, with its error.

drupe does not report a gain of force up to GAIN_SAID. The relation of force and displacement still measures
it in every recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactile.consistency.pressing import pressing_of
from tactile.consistency.relations import gain_of
from tactile.readers.recording import GelPad

GAIN_SAID = 0.08
"""|ln gain| above which a gain is reported, 3.9 standard deviations (tactile/consistency/relations.py)."""
GAIN_SD = GAIN_SAID / 2
"""Prior standard deviation of ln gain: the check's limit is two of them (assumed)."""
LAW_SD = 0.015
"""Standard deviation of a measured ln gain beyond its noise: the law's own error, which all pads of one gel
share. It is half of the 0.03 that valid recordings reach (benchmarks/field_spreads.py)."""


def unseen_error(measured: float, measured_sd: float, *, prior_sd: float) -> float:
    """Root mean square of an error e ~ N(0, prior_sd^2) that was measured as N(e, measured_sd^2).

    With w = prior_sd^2 / (prior_sd^2 + measured_sd^2) the posterior is N(w measured, w measured_sd^2). The
    number is not corrected for e, so that its error is sqrt((w measured)^2 + w measured_sd^2).

    >>> round(unseen_error(0.0, 0.03, prior_sd=0.04), 4), round(unseen_error(0.08, 0.0, prior_sd=0.04), 4)
    (0.024, 0.08)
    """
    if prior_sd == 0.0:
        return 0.0
    w = prior_sd**2 / (prior_sd**2 + measured_sd**2)
    return float(np.sqrt((w * measured) ** 2 + w * measured_sd**2))


@dataclass(frozen=True, kw_only=True)
class UnseenGain:
    """Root mean square of ln gain in two independent parts: `shared` by all recordings of the gripper, and
    `independent` between recordings.
    """

    shared: float
    independent: float = 0.0


def unseen_gain(pads: Sequence[GelPad]) -> UnseenGain:
    """Unseen gain of all pads of all recordings; the prior alone if no pad is informative. A gain that the
    check reports counts as 0 here: the finding has an error of its own.
    """
    gains = [gain for pad in pads if (gain := _of_pad(pad)) is not None]
    if not gains:
        return UnseenGain(shared=GAIN_SD)
    measured, noise_sd = np.transpose(gains)
    return gain_left(np.where(np.abs(measured) > GAIN_SAID, 0.0, measured), noise_sd)


def gain_left(measured: Float[np.ndarray, " n"], noise_sd: Float[np.ndarray, " n"]) -> UnseenGain:
    """Root mean square of an uncorrected ln gain after n measurements of it.

    Their mean m has the variance s^2 = LAW_SD^2 + mean(noise_sd^2) / n: the law's error does not average out.
    The prior is N(0, GAIN_SD^2), w the weight of m. The mean square (w m)^2 + w s^2 (unseen_error) is
    independent^2 + shared^2, where independent = w * noise is the error of w m by noise.
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
    """ln gain and its standard deviation by noise; None if the gel's law says nothing about the pad."""
    press = pressing_of(pad)
    if gain_of(press) is None or press.gel_mm is None:
        return None
    felt, gel = (x[:, press.touched, 2].sum(axis=1) for x in (press.felt_mm, press.gel_mm))
    gain, sd = slope_of(felt, gel)
    return (float(np.log(gain)), sd) if gain > 0 else None


def slope_of(x: Float[np.ndarray, " t"], y: Float[np.ndarray, " t"]) -> tuple[float, float]:
    """Slope of y on x, and its relative standard deviation sqrt(c sum r^2 / ((t - 2) sum (x - mean x)^2)).

    r are the residuals of y; c = (1 + rho) / (1 - rho) with the correlation rho of r between neighbouring
    frames, since correlated errors count as fewer frames.
    """
    about, rises = x - x.mean(), y - y.mean()
    square = max(float(about @ about), 1e-30)
    slope = float(about @ y) / square
    left = rises - slope * about
    squares = float(left @ left)
    rho = float(np.clip(left[1:] @ left[:-1] / max(squares, 1e-30), 0.0, 0.9))
    variance = (1 + rho) / (1 - rho) * squares / max(len(x) - 2, 1) / square
    return slope, float(np.sqrt(variance)) / max(abs(slope), 1e-12)

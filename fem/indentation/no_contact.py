"""The load cell's noise, from frames before contact, and the frame of first touch."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.coloured_noise import variance_inflation
from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.trace import IndenterTrace

#: least number of no-contact frames from which the noise is estimated
FEWEST = 20
#: frames for which a force must exceed the no-contact level, and by how many standard deviations
STAYS, ABOVE = 3, 6.0
#: largest accepted correlation of neighbouring frames
MOST_LAG1 = 0.95
#: variance of the third difference of unit white noise, and a normal's sd over its median absolute deviation
THIRD, MAD = 20.0, 1.4826


@dataclass(frozen=True, kw_only=True)
class NoContactNoise:
    """The load cell's own noise: standard deviation, correlation `lag1` of neighbouring frames, and degrees
    of freedom `frames` of both estimates.
    """

    sd_N: float
    lag1: float
    frames: int

    @property
    def slow_N(self) -> float:
        """White noise with the same spectral density at low frequency, where the effects are."""
        return self.sd_N * float(np.sqrt(variance_inflation(np.array([self.lag1]))[0]))


def first_touch(trace: IndenterTrace) -> int:
    """The first of three successive frames whose force exceeds the first frames' level by more than noise."""
    force = trace.force_N
    level, noise_N = float(np.median(force[:STAYS])), _rough_N(force)
    for _ in range(2):
        above = force > level + ABOVE * noise_N
        stays = np.convolve(above, np.ones(STAYS), "valid") == STAYS
        touch = int(np.argmax(stays))
        if touch < 2 * STAYS:
            break
        level = float(np.median(force[: touch - 1]))
    return touch


def require_force(trace: IndenterTrace) -> NoContactNoise:
    """The noise of one recording. Raises FemFailure (no-load) if no force exceeds it clearly, or the indenter
    never moves.
    """
    for values, what in ((trace.force_N, "force"), (trace.travel_mm, "travel")):
        if np.ptp(values) == 0:
            raise FemFailure(
                FemProblem.NO_LOAD,
                f"indenter trace: found a {what} of {values[0]:.3g} {'N' if what == 'force' else 'mm'} in "
                f"every frame, expected one that changes: was another column taken for the {what}?",
            )
    touch = first_touch(trace)
    no_contact = no_contact_noise(trace, touch)
    if trace.force_N.max() - np.median(trace.force_N[: max(touch, 1)]) < 10 * no_contact.slow_N:
        raise FemFailure(
            FemProblem.NO_LOAD,
            f"indenter trace: found a largest force of {trace.force_N.max():.3g} N in noise of "
            f"{no_contact.slow_N:.2g} N (of what comes before the touch), expected ten times the noise: "
            "press deeper, or more slowly where the machine's own motion shakes the load cell.",
        )
    return no_contact


def pooled_noise(trace: IndenterTrace) -> NoContactNoise:
    """Noise of several recordings by one load cell: variances weighted by their numbers of frames."""
    each = [no_contact_noise(part, first_touch(part)) for part in trace.parts]
    if len(each) == 1:
        return each[0]
    weights = [max(noise.frames, 1) for noise in each]
    variance, lag1 = np.average([(noise.sd_N**2, noise.lag1) for noise in each], axis=0, weights=weights)
    return NoContactNoise(
        sd_N=float(variance**0.5), lag1=float(lag1), frames=sum(noise.frames for noise in each)
    )


def no_contact_noise(trace: IndenterTrace, touch: int) -> NoContactNoise:
    """Noise of the frames before `touch`, minus a fitted line: autoregressive, like markers' noise.

    With fewer than twenty frames, white noise from the third differences of the whole curve, in which a
    smooth force almost vanishes. The noise is at least the quantisation step of the load cell over root 12.
    """
    least = max(_step_N(trace.force_N) / np.sqrt(12), 1e-6 * float(np.abs(trace.force_N).max()))
    calm = max(touch - 1, 0)
    if calm < FEWEST:
        white = max(_rough_N(trace.force_N), least)
        return NoContactNoise(sd_N=white, lag1=0.0, frames=len(trace.force_N) // 4)
    time, force = trace.time_s[:calm], trace.force_N[:calm]
    detrended = force - np.polynomial.Polynomial.fit(time, force, 1)(time)
    square = float(detrended @ detrended)
    lag1 = float(detrended[1:] @ detrended[:-1]) / square if square > (calm - 2) * least**2 else 0.0
    return NoContactNoise(
        sd_N=max(float(np.sqrt(square / (calm - 2))), least),
        lag1=min(lag1, MOST_LAG1) if lag1 > 2 / np.sqrt(calm) else 0.0,
        frames=calm - 2,
    )


def _rough_N(force: Float[np.ndarray, " t"]) -> float:
    """Noise from third differences; their median is insensitive to a few jumps."""
    third = np.abs(np.diff(force, 3))
    return MAD * float(np.median(third)) / np.sqrt(THIRD) or 1e-6 * float(np.abs(force).max())


def _step_N(force: Float[np.ndarray, " t"]) -> float:
    """The smallest difference between two different readings."""
    steps = np.diff(np.unique(force))
    return float(steps.min()) if len(steps) else 0.0

"""Noise of a gel sensor without contact, and of a record, by robust statistics of its differences."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

FEWEST_NO_CONTACT_FRAMES = 5
"""With fewer no-contact frames their spread is too uncertain, and second differences of frames are used."""
MOST_LAG1 = 0.95
"""Largest lag-1 correlation of the noise that is used: 1 would make all frames one. Set by hand."""
MEDIAN_OF_GAUSSIAN = 0.6745
"""Median of the absolute value of a standard Gaussian."""
THIRD, MAD = 20.0, 1.4826
"""Variance of the third difference of unit white noise, and a normal's sd over its median absolute
deviation."""
LEAST_SHARE = 1e-6
"""Noise is at least this share of the range: values in double precision have less."""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Noise of one quantity of one pad.

    `offset` per marker (the reference frame's own noise, common to all frames). `sd` about it: of one
    component of one marker in one frame. `lag1`: its correlation with the next frame.
    """

    offset: Float[np.ndarray, "n 3"]
    sd: float
    lag1: float


def no_contact_noise(values: Float[np.ndarray, "t n 3"]) -> Noise:
    """Offset, standard deviation and lag-1 correlation of no-contact frames.

    The offset is the mean over the frames. The correlation is corrected for that mean, which lowers every lag
    of T frames by about 1/T. Needs at least two frames.
    """
    frames = len(values)
    offset = values.mean(axis=0)
    about = values - offset
    sd = float(np.sqrt((about**2).sum() / (values[0].size * (frames - 1))))
    if sd == 0.0:
        return Noise(offset=offset, sd=0.0, lag1=0.0)
    neighbours = float((about[1:] * about[:-1]).sum() / (about**2).sum()) * frames / (frames - 1)
    return Noise(offset=offset, sd=sd, lag1=float(np.clip(neighbours + 1 / frames, 0.0, MOST_LAG1)))


def noise_in_contact(values: Float[np.ndarray, "t n 3"]) -> Noise:
    """The noise of a recording without usable no-contact frames; its offset is unknown, so it is zero.

    A signal that is smooth over three frames has no second difference; white noise of standard deviation sd
    has one of sqrt(6) sd. Only the quieter half of the frames counts, which excludes jumps of the signal.
    Values that do not change at all (a deadband) are left out.
    """
    zero = np.zeros(values.shape[1:])
    if len(values) < 3:
        return Noise(offset=zero, sd=0.0, lag1=0.0)
    bends = np.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    per_frame = [float(np.median(frame[frame > 0])) for frame in bends if (frame > 0).any()]
    if not per_frame:
        return Noise(offset=zero, sd=0.0, lag1=0.0)
    quiet = np.sort(per_frame)[: max(1, len(per_frame) // 2)]
    return Noise(offset=zero, sd=float(quiet.mean() / MEDIAN_OF_GAUSSIAN / np.sqrt(6)), lag1=0.0)


def noise_sd(values: Float[np.ndarray, " t"]) -> float:
    """Standard deviation of white noise, from third differences: a smooth course adds almost nothing, and
    their median ignores a few jumps. At least that of rounding to the smallest step of the values.

    >>> noise = np.random.default_rng(0).normal(scale=0.1, size=10_000)
    >>> round(noise_sd(np.linspace(0, 50, 10_000) + noise), 2)
    0.1
    """
    if len(values) < 4:
        return 1e-12
    third = MAD * float(np.median(np.abs(np.diff(values, 3)))) / THIRD**0.5
    middle = float(np.ptp(np.percentile(values, [2, 98])))  # a few wild values do not change it
    return float(max(third, resolution(values) / 12**0.5, LEAST_SHARE * middle, 1e-12))


def resolution(values: Float[np.ndarray, " t"]) -> float:
    """The smallest difference between two different values; 0 if all are equal.

    >>> resolution(np.array([0.0, 0.5, 0.75, 0.75]))
    0.25
    """
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-9 * max(float(np.abs(values).max(initial=0.0)), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0

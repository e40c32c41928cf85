"""What a pad feels after it has let go: nothing, unless its sensor drifts (channel R4).

The recorded normal force in the frames in the air, after the last contact less before the first, over the
time between: a rate, N/s, that no physics of the fruit changes. It is known to the noise of a mean over all
markers and frames, and to what a gel may still remember of the press.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.coloured_noise import variance_inflation
from fem.grasp_history import GraspHistory

FEWEST_FRAMES = 2
"""In the air on either side: a mean and its spread need two."""
REMEMBERED = 3e-3
"""Share of the greatest force that a gel may still show after it was let go (estimate)."""
SILENT = 0.5
"""A sensor that says exactly nothing more often than this in the air cuts off small forces, and drifts."""
SURE = 4.0
"""A rate of so many standard deviations is there."""


@dataclass(frozen=True, kw_only=True)
class ZeroDrift:
    """Growth of one pad's normal force in the air, N/s, and its standard deviation; `from_s`: since when."""

    rate_N_per_s: float
    sd_N_per_s: float
    from_s: float

    @property
    def sure(self) -> bool:
        """Whether more than noise and memory grows."""
        return abs(self.rate_N_per_s) > SURE * self.sd_N_per_s

    def grown_N(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        """What the pad's normal force has grown by at these times, N."""
        return np.asarray(self.rate_N_per_s * (time_s - self.from_s))


@dataclass(frozen=True, kw_only=True)
class ZeroDrifts:
    """Of all pads of a recording: rates, N/s, and inverse variances, zero where nothing is known."""

    measured: Float[np.ndarray, " p"]
    weight: Float[np.ndarray, " p"]

    @classmethod
    def of(cls, history: GraspHistory, normals: Float[np.ndarray, "p 3"]) -> "ZeroDrifts":
        """`normals`: of the pads, towards the fruit's inside, in the fruit's frame."""
        drifts = [zero_drift(history, pad, normal) for pad, normal in enumerate(normals)]
        return cls(
            measured=np.array([0.0 if drift is None else drift.rate_N_per_s for drift in drifts]),
            weight=np.array([0.0 if drift is None else drift.sd_N_per_s**-2 for drift in drifts]),
        )


def zero_drift(history: GraspHistory, pad: int, normal: Float[np.ndarray, "3"]) -> ZeroDrift | None:
    """Of one pad; None with fewer than FEWEST_FRAMES in the air before or after the contact, or SILENT ones.

    The frames next to the contact may carry forces below what counts as one, and are left out.
    """
    pad_history = history.pads[pad]
    touched = np.flatnonzero([phase != "air" for phase in history.phase])
    if not len(touched):
        return None
    before, after = np.arange(touched[0] - 1), np.arange(touched[-1] + 2, len(history.phase))
    if min(len(before), len(after)) < FEWEST_FRAMES:
        return None
    if (pad_history.force_N[np.concatenate([before, after])] == 0).mean() > SILENT:
        return None
    total = (pad_history.force_N @ normal).sum(axis=1)
    apart_s = float(history.time_s[after].mean() - history.time_s[before].mean())
    inflation = float(variance_inflation(np.array([pad_history.lag1]))[0])
    jumps = np.concatenate([np.diff(total[before]), np.diff(total[after])])
    each = max(
        pad_history.force_sd_N * np.sqrt(pad_history.force_N.shape[1]), float(jumps.std()) / np.sqrt(2)
    )
    noise = each * np.sqrt(inflation * (1 / len(before) + 1 / len(after)))
    return ZeroDrift(
        rate_N_per_s=float(total[after].mean() - total[before].mean()) / apart_s,
        sd_N_per_s=float(np.hypot(noise, REMEMBERED * np.abs(total).max())) / apart_s,
        from_s=float(history.time_s[before].mean()),
    )

"""Zero drift: growth of a pad's normal force without contact, by its sensor (channel R4).

The rate, N/s, is the mean normal force in no-contact frames after the last contact less that before the
first, over the time between. No physics of the fruit changes it. Its error is the noise of a mean over all
markers and frames, and the gel's memory of the press.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.coloured_noise import variance_inflation
from fem.grasp_history import GraspHistory

FEWEST_FRAMES = 2
"""No-contact frames on either side: a mean and its spread need two."""
REMEMBERED = 3e-3
"""Share of the greatest force that a gel may still show after release (estimate)."""
SILENT = 0.5
"""A sensor with a larger share of exact zeros without contact cuts off small forces, and drifts."""
SURE = 4.0
"""A rate above this many standard deviations is certain."""


@dataclass(frozen=True, kw_only=True)
class ZeroDrift:
    """Growth of one pad's normal force without contact, N/s, its standard deviation; `from_s`: start time."""

    rate_N_per_s: float
    sd_N_per_s: float
    from_s: float

    @property
    def sure(self) -> bool:
        """Whether the rate exceeds noise and gel memory."""
        return abs(self.rate_N_per_s) > SURE * self.sd_N_per_s

    def grown_N(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        """Growth of the pad's normal force by these times, N."""
        return np.asarray(self.rate_N_per_s * (time_s - self.from_s))


@dataclass(frozen=True, kw_only=True)
class ZeroDrifts:
    """Of all pads of a recording: rates, N/s, and inverse variances, zero for an unknown rate."""

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
    """Of one pad; None with fewer than FEWEST_FRAMES without contact before or after it, or SILENT ones.

    The frames next to the contact are left out: they may have forces below the threshold of contact.
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

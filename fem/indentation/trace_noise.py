"""Noise of a curve: the part of the force that a model leaves unexplained, and the load cell's noise."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg.lapack import dpttrf, dpttrs

from fem.cached_value import cached_value
from fem.indentation.no_contact import NoContactNoise
from fem.indentation.trace import IndenterTrace

LOOKS = 10.0
"""Number of independent values of a model's error per force change by the peak force, and per recording. The
residual of rubber laws for silicone cylinders changes sign some five times in a ramp
(`benchmarks/silicone_cylinders.py`). With 20, a law is named for a curve that no law explains."""
FLOOR = 0.03
"""Share of the peak force below which the unexplained part no longer falls with the force (set by hand)."""
SHARE = 0.02
"""Least share of the force that any law leaves unexplained. Of 1, 2 and 3 % it is the least with which laws
fitted to four fifths of a curve predict the last fifth (development mixtures of
benchmarks/silicone_cylinders.py)."""
RIG_SHAPE = 0.3
"""Share of a subtracted rig's standard deviation that is not a common scale of its curve. Set by hand: from
three squeezes of a spring in series with Hertz's contact, the curve's error at the first touch is 0.016 mm,
and its standard deviation at the largest force 0.057 mm (tests/pipeline/test_calibrate.py)."""
STEEPER = 1.5
"""Relative change of a ball's force over the relative change of depth (Hertz)."""


@dataclass(frozen=True, kw_only=True)
class TraceNoise:
    """Covariance white^2 I + a a' exp(-|c - c'|), a and c per frame: an Ornstein-Uhlenbeck process.

    The clock c need not be time: a model's residual changes when the force changes (model_clock).
    O: covariance of the process, with a tridiagonal inverse; A = diag(a). Then C = white^2 I + A O A and
    C^-1 = (I - (I + white^2 Q)^-1)/white^2 with Q = (A O A)^-1, so that every use costs a banded solve.
    Source: Rue and Held, "Gaussian Markov Random Fields", 2005, sec. 1.2 and 2.4 (Markov precision).
    """

    white_N: float
    wander_N: Float[np.ndarray, " t"]
    clock: Float[np.ndarray, " t"]

    def part(self, frames: slice | Bool[np.ndarray, " t"], factor: float = 1.0) -> "TraceNoise":
        """Noise of some of the frames, with the unexplained force times `factor`."""
        return replace(self, wander_N=factor * self.wander_N[frames], clock=self.clock[frames])

    @cached_value
    def _process(self) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t-1"], float]:
        """O^-1, the process's precision on this clock: diagonal, off-diagonal, and log determinant."""
        passed = np.diff(self.clock)
        fade, fresh = np.exp(-passed), -np.expm1(-2 * passed)
        diagonal = np.ones(len(self.clock))
        diagonal[:-1] += fade**2 / fresh
        diagonal[1:] += 1 / fresh - 1
        return diagonal, -fade / fresh, float(-np.log(fresh).sum())

    def _factored(
        self, wander_N: Float[np.ndarray, " t"]
    ) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t-1"]]:
        """L D L' factors of I + white^2 Q with this a: D, and the subdiagonal of L."""
        diagonal, off, _ = self._process
        diagonal = 1 + (self.white_N / wander_N) ** 2 * diagonal
        off = off * self.white_N**2 / (wander_N[:-1] * wander_N[1:])
        factor, below, info = dpttrf(np.asarray_chkfinite(diagonal), np.asarray_chkfinite(off))
        if info:
            raise np.linalg.LinAlgError(f"not positive definite from row {info} on")
        return factor, below

    @cached_value
    def _factors(self) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t-1"]]:
        return self._factored(self.wander_N)

    def solve(self, columns: Float[np.ndarray, " t *c"]) -> Float[np.ndarray, " t *c"]:
        """C^-1 times columns."""
        solved, _ = dpttrs(*self._factors, np.asarray_chkfinite(columns))
        return np.asarray((columns - solved.reshape(columns.shape)) / self.white_N**2)

    def log_likelihoods(
        self, residual: Float[np.ndarray, " t"], shares: Float[np.ndarray, " s"]
    ) -> Float[np.ndarray, " s"]:
        """Natural logarithm of the normal density, with a multiplied by each share."""
        residual = np.asarray_chkfinite(residual)
        log_o = self._process[2]
        logs = []
        for wander_N in shares[:, None] * self.wander_N:
            factors = self._factored(wander_N)
            weighted = (residual - dpttrs(*factors, residual)[0]) / self.white_N**2
            log_det = np.log(factors[0]).sum() - log_o + 2 * np.log(wander_N).sum()
            logs.append(-0.5 * (residual @ weighted + log_det + len(residual) * np.log(2 * np.pi)))
        return np.array(logs)


def noise_of(trace: IndenterTrace, no_contact: NoContactNoise) -> TraceNoise:
    """White noise plus an unexplained part of the size of the measured force, at least FLOOR of its peak."""
    size = np.abs(trace.force_N)
    clocks, end = [], 0.0
    for part in trace.parts:  # LOOKS decorrelates each recording from the next
        clocks.append(end + model_clock(part.time_s, part.force_N, white_N=no_contact.sd_N))
        end = float(clocks[-1][-1]) + LOOKS
    return TraceNoise(
        white_N=no_contact.slow_N,
        wander_N=np.maximum(size, FLOOR * size.max()),
        clock=np.concatenate(clocks),
    )


def model_clock(
    time_s: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"], *, white_N: float
) -> Float[np.ndarray, " t"]:
    """Clock that advances with changes of the force (over its peak) and with time (over the recording), LOOKS
    times each.

    A model's error has one value per section of the path, not per frame: a curve has some thirty independent
    values, whatever the number of frames.
    """
    change = (np.abs(np.diff(force_N)) + white_N) / np.abs(force_N).max()
    passed = np.diff(time_s) / (time_s[-1] - time_s[0])
    return np.asarray(LOOKS * np.cumsum(np.r_[0.0, change + passed]))


def least_share(trace: IndenterTrace) -> float:
    """Least unexplained share of the force: SHARE, or the error by the shape of a rig's curve.

    That error is STEEPER RIG_SHAPE sd / d at the peak, d the travel since FLOOR of the peak force.
    """
    if trace.rig_sd_mm is None:
        return SHARE
    if len(trace.parts) > 1:
        return max(least_share(part) for part in trace.parts)
    peak = int(np.argmax(trace.force_N))
    below = np.flatnonzero(trace.force_N[: peak + 1] < FLOOR * trace.force_N[peak])
    start = int(below[-1]) if len(below) else 0
    depth = max(float(trace.travel_mm[peak] - trace.travel_mm[start]), 1e-6)
    return max(SHARE, float(STEEPER * RIG_SHAPE * trace.rig_sd_mm[peak] / depth))

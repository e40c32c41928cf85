"""Noise of a trace: what the load cell adds, and what a model leaves unexplained of the force."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dpttrf, dpttrs

from fem.cached_value import cached_value
from fem.indentation.trace import IndenterTrace

#: independent looks at a model's error per peak force passed, and per recording: what laws of rubber leave of
#: silicone cylinders changes sign some five times in a ramp (benchmarks/silicone_cylinders.py)
LOOKS = 10.0


@dataclass(frozen=True, kw_only=True)
class NoContactNoise:
    """The load cell's own noise: white, and a coloured part of which `fade` lives on to the next frame.

    `frames`: degrees of freedom that it was estimated from.
    """

    white_N: float
    coloured_N: float
    fade: float
    frames: int

    @property
    def slow_N(self) -> float:
        """White noise of the same density at low frequency, where all that is looked for lies."""
        return float(np.sqrt(self.white_N**2 + self.coloured_N**2 * (1 + self.fade) / (1 - self.fade)))

    def covariance(self, frames: int) -> Float[np.ndarray, "t t"]:
        """Of so many frames: white^2 I + coloured^2 fade^|i - j|."""
        apart = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
        return np.asarray(self.white_N**2 * np.eye(frames) + self.coloured_N**2 * self.fade**apart)


@dataclass(frozen=True, kw_only=True)
class TraceNoise:
    """Covariance white^2 I + a a' exp(-|c - c'|), a and c per frame: an Ornstein-Uhlenbeck process.

    The clock c need not be time: what a model leaves unexplained moves when the force moves (model_clock).
    With O the process's covariance, whose inverse is tridiagonal, and A = diag(a): C = white^2 I + A O A,
    C^-1 = (I - (I + white^2 Q)^-1)/white^2 with Q = (A O A)^-1, so that every use costs a banded solve.
    Source: Rue and Held, "Gaussian Markov Random Fields", 2005, sec. 1.2 and 2.4 (Markov precision).
    """

    white_N: float
    wander_N: Float[np.ndarray, " t"]
    clock: Float[np.ndarray, " t"]

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
        """I + white^2 Q with this a as L D L': D, and L below its diagonal."""
        diagonal, off, _ = self._process
        square = (self.white_N / wander_N) ** 2
        scaled_off = off * self.white_N**2 / (wander_N[:-1] * wander_N[1:])
        if not np.isfinite(scaled_off).all():
            raise ValueError("the noise of a force is not finite or not positive")
        if not len(scaled_off):
            return 1 + square * diagonal, np.zeros(1)
        factor, below, info = dpttrf(1 + square * diagonal, scaled_off, overwrite_d=True, overwrite_e=True)
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

    def log_likelihood(self, residual: Float[np.ndarray, " t"]) -> float:
        """Natural logarithm of the normal density."""
        return float(self.log_likelihoods(residual, np.ones(1))[0])

    def log_likelihoods(
        self, residual: Float[np.ndarray, " t"], shares: Float[np.ndarray, " s"]
    ) -> Float[np.ndarray, " s"]:
        """`log_likelihood` with a times each share in place of a."""
        residual = np.asarray_chkfinite(residual)
        log_o = self._process[2]
        logs = []
        for wander_N in shares[:, None] * self.wander_N:
            factors = self._factored(wander_N)
            weighted = (residual - dpttrs(*factors, residual)[0]) / self.white_N**2
            log_det = np.log(factors[0]).sum() - log_o + 2 * np.log(wander_N).sum()
            logs.append(-0.5 * (residual @ weighted + log_det + len(residual) * np.log(2 * np.pi)))
        return np.array(logs)


def joint_clock(trace: IndenterTrace, *, white_N: float) -> Float[np.ndarray, " t"]:
    """`model_clock` of each recording, with what unties one from the next between them."""
    clocks, end = [], 0.0
    for part in trace.parts:
        clocks.append(end + model_clock(part.time_s, part.force_N, white_N=white_N))
        end = float(clocks[-1][-1]) + LOOKS
    return np.concatenate(clocks)


def model_clock(
    time_s: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"], *, white_N: float
) -> Float[np.ndarray, " t"]:
    """Runs with the force's changes (over its peak) and with time (over the recording), LOOKS times each.

    A model's error has one value per stretch of path, not per frame: a trace is some sixty independent looks
    at it, however many frames were recorded.
    """
    change = (np.abs(np.diff(force_N)) + white_N) / np.abs(force_N).max()
    passed = np.diff(time_s) / (time_s[-1] - time_s[0])
    return np.asarray(LOOKS * np.cumsum(np.r_[0.0, change + passed]))
